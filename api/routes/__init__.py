"""One module of thin endpoints per resource."""
