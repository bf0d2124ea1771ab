"""Permissions: keys with their scopes, the callers they stand for, and where a service without keys may listen."""
