"""The studies: one module per notebook, and the catalogue that lists them."""
