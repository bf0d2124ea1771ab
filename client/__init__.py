"""HTTP client and command line."""
