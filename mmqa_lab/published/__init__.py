"""The published tables, one module per paper, each with its source and page."""
