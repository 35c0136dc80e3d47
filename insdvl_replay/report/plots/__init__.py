"""Small plots, drawn by hand of a few functions: panels of curves on two axes, for pages with dozens of them.

`panel` says what there is to draw, `envelope` makes long series short without hiding their peaks, `axis` finds ticks,
`svg` draws, and `png` lets matplotlib draw the same. Colours and dashes are classes of the page's style sheet, so that
a page decides about light and dark.
"""
