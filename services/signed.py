"""Numbers with a sign, as tables show them."""


def signed(value: float, form: str) -> str:
    """A number with its sign in a format such as ".3f" or ".3g": "+0.120", "-3.4". A zero has no minus."""
    return f"{value:+z{form}}"
