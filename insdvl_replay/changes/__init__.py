"""Changes between results: answers (`answer`), cells over many dives (`comparison`), and gates on cells (`gates`)."""
