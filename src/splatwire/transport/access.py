"""Access rules for the scenes of a server.

Clients need a signed token for private scenes. Unlisted scenes need no token, but are omitted from lists of scenes.
"""

from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class Access:
    """Access rules for the scenes of a server.

    Attributes:
        private: Names of the scenes that need a token; lists of scenes omit these, too.
        unlisted: Names of further scenes that lists of scenes omit, but that need no token.
        problem: Function that is called with a token and the name of a scene. Returns the reason why the token does not
            open the scene, or None if it does. None if no scene is private.
    """

    private: frozenset[str] = frozenset()
    unlisted: frozenset[str] = frozenset()
    problem: Callable[[str, str], str | None] | None = None

    def is_listed(self, name: str) -> bool:
        """Returns True if lists of scenes contain the scene `name`: it is neither private nor unlisted."""
        return name not in self.private and name not in self.unlisted

    def refusal(self, name: str, token: str, *, exists: bool = True) -> str | None:
        """Returns the reason why a request for a scene is refused; None if it is allowed.

        Args:
            name: Name of the scene.
            token: Token of the request; empty if the request has none.
            exists: False if there is no such scene. If any scene is private, this one needs a token, too, so that the
                refusal does not reveal which private scenes exist.
        """
        if name not in self.private and (exists or not self.private):
            return None
        if not token or self.problem is None:
            return "this scene needs a token"
        return self.problem(token, name)
