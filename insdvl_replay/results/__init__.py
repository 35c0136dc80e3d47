"""A result: the files of its folder, written and read, and the page that shows it.

`json_report` builds the `Report`, which holds a result and survives being saved and read again. `summary` lays several
beside each other. `result_files` writes all of a replay, `folder` lets it appear all at once or not at all, and
`stored_results` finds results again. `dive_page` and `index_page` say what stands on each page, `output` what is
printed; `dive_figures` and `figures` choose what to draw of a dive.
"""
