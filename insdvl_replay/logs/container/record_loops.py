"""Names of `logs.formats` for those who still ask here."""
