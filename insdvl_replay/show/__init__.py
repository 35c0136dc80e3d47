"""Results as people and programs read them. Nothing here computes a result, and nothing here prints.

`render` writes a `core.result.Result` in any format and into a folder. `document` has tables and numbers, `text` the
terminal, Markdown, LaTeX and CSV, `page` HTML, `plot` figures as SVG. `dive` and `dives` say what is shown of replays.
"""
