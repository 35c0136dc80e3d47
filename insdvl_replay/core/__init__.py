"""What every room speaks of: columns, settings, notes and errors, tables of a result, and what the program runs on."""
