"""Reports: one self-contained HTML page, with the data it shows in a JSON file beside it."""
