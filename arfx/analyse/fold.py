"""What is folded over the frames of a clip, one after the other, and can be stopped after any of them."""

from __future__ import annotations

from typing import Any, ClassVar


class Fold:
    """All attributes are the state, which `core.codec` must be able to write; folds among them have their own.

    given : names of the attributes that the constructor's arguments make and no frame changes
    """

    given: ClassVar[frozenset[str]] = frozenset()

    def state(self) -> dict[str, Any]:
        """By attribute. It is shared with the fold: to be written before the next frame."""
        kept = {k: v for k, v in vars(self).items() if k not in self.given}
        return {k: v.state() if isinstance(v, Fold) else v for k, v in kept.items()}

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from `state` of a fold that was made with the same arguments: to the same bits."""
        for k, v in state.items():
            mine = getattr(self, k)
            if isinstance(mine, Fold):
                mine.restore(v)
            else:
                setattr(self, k, v)
