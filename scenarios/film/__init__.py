"""Films and stills of a run, from its folder."""

from scenarios.film.plan import Wish
from scenarios.film.render import render

__all__ = ["Wish", "render"]
