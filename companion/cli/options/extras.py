"""How to get the packages of an optional extra: one wording for all messages."""


def how_to_install(extra: str) -> str:
    """What to type, in a checkout, for the packages of an extra."""
    return f'`make install` in a checkout, or .venv/bin/pip install -e ".[{extra}]"'
