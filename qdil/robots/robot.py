"""What a registered robot is: a value that names it, its simulator and its feet. Does not import JAX or Brax."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from qdil.robots.environment import Environment

BACKENDS = ("spring", "positional", "generalized", "mjx")  # Brax's simulators, the default first


class Robot(NamedTuple):
    """A robot of Brax and which of its links are feet; or, with ``environment``, a user's own simulated robot."""

    name: str
    brax_env: str | None  # its name among Brax's environments
    feet: tuple[str, ...]  # links, or collision shapes of links, whose ground contacts are the k measures
    environment: Environment | None = None  # instead of ``brax_env`` and ``feet``

    @property
    def measure_names(self) -> tuple[str, ...]:
        """(k,) one name per measure."""
        return self.feet if self.environment is None else tuple(self.environment.measure_names)
