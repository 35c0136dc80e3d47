"""Output of results, for people and programs. This package neither computes results nor prints.

`render` writes a `core.result.Result` in any format and into a folder. `document` has tables and numbers, `text` the
terminal, Markdown, LaTeX and CSV, `page` HTML, `plot` figures as SVG. `dive` and `dives` say what is shown of replays.
"""
