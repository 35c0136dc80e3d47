"""Changes between results, cell by cell (`cells`), over many dives (`comparison`), and checks by gates (`gates`)."""
