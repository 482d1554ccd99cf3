"""The contract of a stage: what an effect declares and does."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, NamedTuple

from numpy import ndarray

from arfx.core.facts import FrameFacts
from arfx.core.layers import Layer, Layers
from arfx.core.light import Light
from arfx.core.memo import Memos
from arfx.core.noise import noise, noise_key
from arfx.core.pixels import Pixels
from arfx.core.pose import Pose
from arfx.core.rect import Rect
from arfx.core.scene import Scene
from arfx.core.settings import Settings, from_dataclass
from arfx.errors import ArfxError, RenderError

LEVELS = ("draft", "standard", "high", "reference")  # cheapest first


class Demand(NamedTuple):
    """What a stage would change in a frame.
    rect : pixels it may change, empty = it does not run, None = those that an earlier
    stage of the frame may change;  reason : in units
    """

    rect: Rect | None
    reason: str

    @property
    def nothing(self) -> bool:
        """Whether the stage does not run."""
        return self.rect is not None and self.rect.empty


@dataclass(frozen=True, eq=False)
class View:
    """One frame as `run` sees it. view[LAYER] is what the layer holds over `rect`, read-only.
    out : the pixels that are kept of what it makes: a slow stage may leave the others as they are
    key : of its random numbers, from seed, frame and stage;  memo : what it keeps from
    frame to frame
    """

    layers: Layers
    facts: FrameFacts
    scene: Scene
    level: str
    out: Rect
    key: int
    memo: Memos

    def __getitem__(self, name: Layer) -> ndarray:
        return self.layers[name]

    @property
    def rect(self) -> Rect:
        return self.layers.rect

    @property
    def pose(self) -> Pose:
        """CAMERA from WORLD. Raises ValueError in a frame without one: `without_object`
        stages ask the facts.
        """
        return self.facts.pose

    @property
    def light(self) -> Light:
        """The frame's, else the scene's."""
        return self.scene.light_of(self.facts)

    def noise(self, channel: int = 0) -> ndarray:
        """(h, w) float32 in [0, 1): random, new in every frame, the same for a pixel
        whatever the rectangle.
        """
        return noise(self.rect, self.key, channel)


class Check(NamedTuple):
    """An estimate beside its limit. action : what was done about it where it is not ok"""

    name: str
    value: Any
    limit: Any
    ok: bool
    action: str

    def to_json(self) -> dict[str, Any]:
        return {
            "check": self.name,
            "value": self.value,
            "limit": self.limit,
            "verdict": "ok" if self.ok else "warn",
            "action": "none" if self.ok else self.action,
        }


class JobView(NamedTuple):
    """A job whose frames are rendered.
    levels : those at which each stage ran;  picture : renders one frame of a scene by the
    stages named, at these levels, over a
    plate of ones; None where nothing of the model is in view"""

    facts: Sequence[FrameFacts]
    scene: Scene
    levels: Mapping[str, frozenset[str]]
    picture: Callable[[Scene, FrameFacts, Mapping[str, str]], Layers | None]


class Stage:
    """One effect. Required: name, run. The rest has a default that fits an effect on the
    object's own pixels. One instance per job, made from `params` (what the user meant).
    `prepare` once per clip, worker and level; `run` is pure."""

    name: ClassVar[str]
    Params: ClassVar[type] = Settings  # a model of them; a dataclass becomes one
    # some of LEVELS, cheapest first
    levels: ClassVar[tuple[str, ...]] = ("standard",)

    # parts of the analysis that it reads, by name; "depth" : measured depth, where there is one
    facts: frozenset[str] = frozenset({"pose"})
    # input pixels that it takes around each output pixel
    padding_px: int = 0
    # its price is linear in these (core/cost.py)
    terms: ClassVar[tuple[str, ...]] = ("frames", "mpx", "object_mpx")
    # of a plug-in, with its version: set when it is loaded
    distribution: ClassVar[str] = ""
    # it also runs in frames in which the object is not visible
    without_object: ClassVar[bool] = False

    def __init__(self, params: Any = None) -> None:
        self.params: Any = self.Params() if params is None else params

    def __init_subclass__(cls) -> None:
        if not issubclass(cls.Params, Settings):
            cls.Params = from_dataclass(cls.Params)
        missing = [
            n for n in ("name", "run") if getattr(cls, n, None) in (None, Stage.run)
        ]
        if missing:
            raise TypeError(f"stage {cls.__qualname__} lacks {', '.join(missing)}")
        if not cls.levels or cls.levels != tuple(
            n for n in LEVELS if n in cls.levels
        ):
            raise TypeError(
                f"levels of stage {cls.__qualname__} are {cls.levels!r}; they must be a tuple"
                f" of some of {', '.join(LEVELS)}, in this order"
            )

    @classmethod
    def settled(cls, params: Any) -> Any:
        """The settings with what they leave to the machine chosen: once for a job, for all
        workers, and part of its keys.
        """
        return params

    def demand(self, facts: FrameFacts, scene: Scene, frame: Rect) -> Demand:
        """Pixels that it may change in this frame, and why; an empty rectangle: why it does
        not run. The planner does not ask where the object is not visible, unless
        `without_object`."""
        rect = facts.raster_box.clip(frame)
        return Demand(rect, "model out of view" if rect.empty else "model in view")

    def needs(self, out: Rect, facts: FrameFacts, scene: Scene, level: str) -> Rect:
        """Pixels that it reads to make `out`; what lies outside the frame is cut off by the
        planner.
        """
        return out.pad(self.padding_px)

    def once(self, facts: FrameFacts) -> Mapping[str, Hashable]:
        """Terms of its price whose work is done once for each new value: {"new_lights":
        what the light is known by}.
        """
        return {}

    def prepare(self, scene: Scene, level: str) -> Any:
        """What the code needs (textures, tables). Raises InputError, RenderError."""
        return None

    def health(self, job: JobView) -> Iterable[Check]:
        """What it estimated in a job, for the report."""
        return ()

    def run(self, view: View, prepared: Any) -> Mapping[Layer, ndarray | Pixels]:
        """What it writes, over the rectangle of the view: a plug-in IMAGE, the renderer's parts
        layers that later ones read. prepared : what `prepare` returned"""
        raise NotImplementedError


@contextlib.contextmanager
def blamed(stage: Stage | type[Stage], when: str) -> Iterator[None]:
    """What a plug-in raises in the body, arfx's errors apart, becomes a RenderError that
    names it.
    """
    try:
        yield
    except ArfxError:
        raise
    except (Exception, SystemExit) as e:
        if not stage.distribution:
            raise
        raise RenderError(
            f"stage {stage.name!r} of {stage.distribution} fails {when}:"
            f" {type(e).__name__}: {e}",
            "tell its authors (ARFX_DEBUG=1 shows where), or leave it out",
        ) from e


@dataclass(frozen=True, eq=False)
class ReadyStage:
    """A stage at one level, with what it prepared for a clip and what it keeps; threads may
    share it.
    """

    stage: Stage
    scene: Scene
    level: str
    prepared: Any
    memo: Memos = field(default_factory=Memos)

    @staticmethod
    def of(stage: Stage, scene: Scene, level: str) -> ReadyStage:
        with blamed(stage, "while it prepares"):
            return ReadyStage(stage, scene, level, stage.prepare(scene, level))

    def view(
        self, layers: Layers, facts: FrameFacts, out: Rect | None = None
    ) -> View:
        """out : None = all"""
        key = noise_key(self.scene.seed, facts.index, self.stage.name)
        return View(
            layers,
            facts,
            self.scene,
            self.level,
            layers.rect if out is None else out,
            key,
            self.memo,
        )

    def run(
        self, layers: Layers, facts: FrameFacts, out: Rect | None = None
    ) -> Mapping[Layer, ndarray | Pixels]:
        """One frame by itself."""
        return self.stage.run(self.view(layers, facts, out), self.prepared)


def level_named(levels: Sequence[str], name: str) -> str:
    """The level of that name, or the nearest one below that the stage has; else its cheapest."""
    if name in levels:
        return name
    below = [level for level in levels if level in LEVELS[: LEVELS.index(name)]]
    return below[-1] if below else levels[0]
