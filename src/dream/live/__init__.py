"""Run folders, as they are written → a page in a browser."""
