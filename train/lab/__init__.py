"""The lab: a local page on which one draws problems and watches searches (docs/lab.md)."""
