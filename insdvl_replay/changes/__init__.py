"""What moved between results, cell by cell (`cells`): over many dives (`comparison`), and against rules (`gates`)."""
