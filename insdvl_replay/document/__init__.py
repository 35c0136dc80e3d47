"""The document of a result: its parts, and how they are written. It knows no replay, and neither computes nor prints.

`parts` are what a command returns, `tables` makes tables of rows and texts of numbers, and `render` writes a
`parts.Result` in any format and into a folder: `text` for the terminal and as Markdown, `latex`, `page` as HTML with
figures that `plot` draws. `paper` draws a figure for papers.
"""
