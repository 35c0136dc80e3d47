"""From tables to bytes, one file per format and page. Nothing here computes a result; nothing here prints.

`json_report` builds the `Report`, which holds a result and survives being saved and read again. `summary` lays several
beside each other. `shown` turns a report into tables for people, which `terminal` and `markup` dress. `csv_tables` and
`run_log` write the plain files, and `folder` lets them appear all at once or not at all.

`page` is the frame of every HTML page. `dive_page`, `study_page` and `index_page` say what stands on each; `figures`
chooses what to draw of a dive, and `plots` draws it.
"""
