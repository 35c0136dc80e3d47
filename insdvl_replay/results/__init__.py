"""A result: the files of its folder, written and read, and the page that shows it.

`json_report` builds the `Report`, which holds a result and survives being saved and read again. `result_files` writes
all of a replay, `folder` lets it appear all at once or not at all, and `stored_results` finds results again.
`dive_document` says what is shown of a dive, with `dive_tables` and `dive_figures`; `overviews` lay several dives
beside each other.
"""
