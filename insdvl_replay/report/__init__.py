"""From documents to bytes, one file per format. Nothing here computes a result; nothing here prints.

`document` is what is to be shown, in parts; `display_table` a table for people. `terminal`, `markdown`, `latex` and
`page` render them, `csv_tables` writes plain tables. `plots` and `pictures` draw.
"""
