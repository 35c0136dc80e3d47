"""From tables to bytes, one file per format. Nothing here computes a result; nothing here prints.

`display_table` is a table for people, which `terminal`, `markup` and `page` dress. `csv_tables` writes plain ones.
`page` is the frame of every HTML page, `plots` and `pictures` draw.
"""
