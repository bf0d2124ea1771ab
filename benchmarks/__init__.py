"""Side-by-side measurements. Each benchmark writes a result file, from which the pages of docs/ are made."""
