"""From documents to bytes, one file per format. Nothing here computes a result; nothing here prints.

`document` is what is to be shown, in parts, tables for people among them. `terminal`, `markdown`, `latex` and `page`
render it, `csv_tables` writes plain tables, and `plots` draws.
"""
