"""Optional parts of the installation: where one is missing, a sentence names the extra that installs it."""

from collections.abc import Iterator
from contextlib import contextmanager

from qdil.errors import ConfigError


@contextmanager
def needs(extra: str, feature: str) -> Iterator[None]:
    """Import what ``feature`` needs inside this block; ``extra`` is the one of ``pyproject.toml`` that installs it.

    Raises ConfigError with one sentence in place of ModuleNotFoundError, except for a module of this package, which no
    extra installs.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        missing = (error.name or "").split(".")[0]
        if missing == __package__:
            raise
        raise ConfigError(f"{feature} needs the package {missing}: pip install 'qdil[{extra}]'") from None
