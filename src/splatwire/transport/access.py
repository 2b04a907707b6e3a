"""Access rules for the scenes of a server.

Clients need a signed token for private scenes. Unlisted scenes need no token, but are omitted from lists of scenes.
"""

from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class Access:
    """Access rules for the scenes of a server.

    Attributes:
        private: Names of the scenes that need a token.
        unlisted: Names of scenes that need no token, but do not appear in lists of scenes.
        problem: Function that checks a token. It takes the token and the name of a scene, and returns the reason for
            refusing the token, or None for a valid one. Not needed without private scenes.
    """

    private: frozenset[str] = frozenset()
    unlisted: frozenset[str] = frozenset()
    problem: Callable[[str, str], str | None] | None = None

    def is_listed(self, name: str) -> bool:
        """Returns True if a scene is neither private nor unlisted."""
        return name not in self.private and name not in self.unlisted

    def refusal(self, name: str, token: str, *, exists: bool = True) -> str | None:
        """Returns the reason for refusing a request for a scene, or None for a permitted request.

        Args:
            name: Name of the scene.
            token: Token of the request; empty if the request has none.
            exists: False if the server has no such scene. A server with private scenes then refuses the request as for
                a private scene, so that clients cannot find out which scenes exist.
        """
        if name not in self.private and (exists or not self.private):
            return None
        if not token or self.problem is None:
            return "this scene needs a token"
        return self.problem(token, name)
