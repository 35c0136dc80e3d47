"""From tables to bytes, one file per format. Nothing here computes a result; nothing here prints.

`json_report` builds the `Report`, which holds a result and survives being saved and read again. `summary` lays several
beside each other. `shown` turns a report into tables for people, which `terminal` and `markup` dress. `csv_tables` and
`run_log` write the plain files, and `folder` lets them appear all at once or not at all.
"""
