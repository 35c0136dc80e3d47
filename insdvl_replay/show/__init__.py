"""What is shown of replays: the parts of a screen and of a page, in words and figures. `document` writes them.

`screens` has the screens, `dive` and `dives` the results of one dive and of several, `first_screen` how their pages
begin, `plan` what would be run, `figures` curves over time, and `answers` the words on verdict and evidence.
`result_files` writes all of a replay into its folder, and `tracks` its tracks for maps.
"""
