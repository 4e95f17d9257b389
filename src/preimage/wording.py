"""Numbers in sentences."""


def number_of(number: int, noun: str) -> str:
    """So many of them, in words that agree.

    >>> number_of(1, "episode"), number_of(3, "episode"), number_of(0, "joint")
    ('1 episode', '3 episodes', '0 joints')
    """
    return f"{number} {noun}{'' if number == 1 else 's'}"
