"""Clips with truth: which lamps there are, how the prints and the camera move, what the
camera does wrong. Drawn from a case and a seed. The irradiance is summed here, over
directions of the sky, by code that the analysis does not know.

Static axes are those in which the lamps rest: the camera's (x right, y down, z forward)
where a hand turns the print, else the anchor print's (z out of it)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

KEY, ON_CUBE = "36h11:3", ("36h11:10", "36h11:11", "36h11:12", "36h11:13")
ANCHOR_M, OTHER_M, CUBE_M = 0.12, 0.06, 0.08
FRAMES, FPS = 72, 12.0
DISTANCE_M = 0.5
Range = tuple[float, float]
TURNED, ROCKED, AT_REST, HELD = (
    "turned",
    "rocked",
    "at rest",
    "held",
)  # HELD: the prints rest, a hand holds the camera


@dataclass(frozen=True)
class Case:
    """What a clip is drawn from; a range is drawn from evenly.

    clips, whole : how many are fed as readings, and how many go through pixels
    tilt_deg : least and most, of the print;  rate_hz : at which it goes to and fro between them
    apart_deg : between two lamps;  ambient : over the lamps' light;  gradient : share of
    ambient light that comes from one side
    gamma : exponent of the camera's curve over sRGB's;  drift_stops : amplitude
    change : of the lamp half-way, "off" or "moved";  near_m : its distance, 0 = far away;
    size_deg : half-angle of its disc
    pose_off_deg : rms error of the poses that readings come with
    prints : one, board, tilted or cube;  over : share of bright cells that are clipped
    owed : one even lamp and a print turned far: a direction is owed;  never : none may be claimed
    """

    name: str
    clips: int = 10
    whole: int = 0
    tilt_deg: tuple[Range, Range] = ((8, 20), (50, 65))
    motion: str = TURNED
    prints: str = "one"
    rate_hz: Range = (0.2, 0.5)
    lamps: int = 1
    apart_deg: Range = (0, 0)
    ratio: Range = (0.3, 1)
    ambient: Range = (0.3, 0.8)
    gradient: Range = (0, 0)
    bias: Range = (0, 0.008)
    gamma: Range = (0.98, 1.02)
    gloss: Range = (0, 0)
    noise_grey: Range = (0.7, 2)
    pose_off_deg: Range = (0.05, 0.4)
    drift_stops: Range = (0, 0)
    over: float = 0.0
    change: str = ""
    near_m: Range = (0, 0)
    size_deg: Range = (0, 2)
    owed: bool = False
    never: bool = False


FAR, MIDDLE, LITTLE, NONE = (
    ((8, 20), (50, 65)),
    ((8, 20), (30, 50)),
    ((0, 3), (8, 20)),
    ((0, 0), (0, 0)),
)
OFF = (1, 3)
CASES: tuple[Case, ...] = (
    Case("one lamp, 50 to 65°", 20, 3, FAR, owed=True),
    Case("one lamp, 30 to 50°", 16, 0, MIDDLE),
    Case("one print turned by hand, filmed", 0, 8, MIDDLE, rate_hz=(0.5, 0.8)),
    Case("one lamp, 8 to 20°", 10, 2, LITTLE),
    Case("one print at rest, camera at rest", 8, 2, NONE, AT_REST, never=True),
    Case("one print at rest, poses 1 to 3° off", 8, 0, NONE, AT_REST, pose_off_deg=OFF, never=True),
    Case("one print at rest, poses off, drifting", 8, 0, NONE, AT_REST, pose_off_deg=OFF, drift_stops=(0.1, 0.5), never=True),
    Case("one print at rest, poses off, switched", 8, 0, NONE, AT_REST, pose_off_deg=OFF, change="off", never=True),
    Case("one print at rest, hand-held", 6, 2, NONE, HELD, never=True),
    Case("turned about one axis", 8, 1, MIDDLE, ROCKED),
    Case("bias .02 to .08", 10, 1, FAR, bias=(0.02, 0.08), owed=True),
    Case("gamma .85 to 1.15", 10, 2, FAR, gamma=(0.85, 1.15), owed=True),
    Case("gloss", 10, 2, FAR, gloss=(0.02, 0.15), owed=True),
    Case("noise 3 to 8 grey levels", 10, 1, FAR, noise_grey=(3, 8), owed=True),
    Case("large lamp, 20 to 50°", 8, 0, FAR, size_deg=(10, 25), owed=True),
    Case("overexposed", 8, 1, FAR, over=0.3, owed=True),
    Case("near lamp, .6 to 1.5 m", 8, 0, FAR, near_m=(0.6, 1.5)),
    Case("exposure drifts", 10, 2, FAR, drift_stops=(0.1, 0.5)),
    Case("two lamps, 5 to 15°", 10, 1, FAR, lamps=2, apart_deg=(5, 15)),
    Case("two lamps, 15 to 40°", 16, 2, FAR, lamps=2, apart_deg=(15, 40)),
    Case("two lamps, 40 to 90°", 16, 2, FAR, lamps=2, apart_deg=(40, 90)),
    Case("two lamps, 15 to 90°, 30 to 50°", 16, 2, MIDDLE, lamps=2, apart_deg=(15, 90)),
    Case("ambient from one side", 14, 2, FAR, gradient=(0.3, 1)),
    Case("ambient from one side, 30 to 50°", 14, 1, MIDDLE, gradient=(0.3, 1)),
    Case("no lamp", 8, 1, FAR, lamps=0, never=True),
    Case("no lamp, ambient from one side", 8, 0, FAR, lamps=0, gradient=(0.3, 1)),
    Case("switched off half-way", 10, 2, FAR, change="off"),
    Case("moved half-way", 8, 1, FAR, change="moved"),
    Case("board of three prints, turned", 8, 1, MIDDLE, prints="board"),
    Case("board of three prints, exposure drifts", 8, 1, MIDDLE, prints="board", drift_stops=(0.1, 0.5)),
    Case("prints at rest at several tilts", 8, 1, NONE, HELD, prints="tilted"),
    Case("hand-held, cube of markers", 12, 3, NONE, HELD, prints="cube"),
    Case("hand-held, cube, two lamps", 8, 1, NONE, HELD, prints="cube", lamps=2, apart_deg=(15, 90)),
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Lamp:
    """direction : (3,) unit, static axes;  rgb : (3,) radiance of a white surface that
    faces it;  on : (frames,) 0..1
    near_m : its distance from where the print is on average, 0 = far away;  half_deg : of its disc
    """

    direction: np.ndarray
    rgb: np.ndarray
    on: np.ndarray
    near_m: float = 0.0
    half_deg: float = 0.0


@dataclass(eq=False)
class Clip:
    """A drawn clip. turns : (frames, 3, 3), places_m : (frames, 3), camera_from_world
    prints : key to (3, 3), (3,) m: world_from_print;  sky : (m, 3) unit directions, (m, 3)
    radiance over m pi, static axes
    gain : (frames,);  drift : its amplitude in stops, and period in seconds
    bright_side : (3,) unit, middle of what is brighter of the sky, None = it is even"""

    case: Case
    seed: int
    times_s: np.ndarray
    turns: np.ndarray
    places_m: np.ndarray
    prints: dict[str, tuple[np.ndarray, np.ndarray]]
    lamps: list[Lamp]
    ambient: np.ndarray
    sky: tuple[np.ndarray, np.ndarray]
    gain: np.ndarray
    bias: float
    gamma: float
    gloss: float
    noise_grey: float
    drift: tuple[float, float]
    bright_side: np.ndarray | None

    @property
    def camera_rests(self) -> bool:
        return self.case.motion != HELD

    def irradiance(
        self, normals: np.ndarray, frame: int, place_m: np.ndarray | None = None
    ) -> np.ndarray:
        """(..., 3) radiance of white surfaces.

        normals : (..., 3) static axes;  place_m : from where the print is on average
        """
        directions, radiance = self.sky
        out = np.clip(normals @ directions.T, 0, None) @ radiance
        for lamp in self.lamps:
            towards, falls = lamp.direction, 1.0
            if lamp.near_m > 0 and place_m is not None:
                away = lamp.near_m * lamp.direction - place_m
                towards, falls = (
                    away / np.linalg.norm(away),
                    lamp.near_m**2 / float(away @ away),
                )
            disc = disc_directions(towards, lamp.half_deg)
            out = (
                out
                + lamp.on[frame]
                * falls
                * np.clip(normals @ disc.T, 0, None).mean(-1)[..., None]
                * lamp.rgb
            )
        return out


def sphere(count: int) -> np.ndarray:
    """(count, 3) unit vectors, evenly over the sphere (a spiral)."""
    k = np.arange(count) + 0.5
    z, phi = 1 - 2 * k / count, k * np.pi * (3 - np.sqrt(5))
    r = np.sqrt(1 - z * z)
    return np.stack([r * np.cos(phi), r * np.sin(phi), z], -1)


def disc_directions(
    middle: np.ndarray, half_deg: float, count: int = 40
) -> np.ndarray:
    """(count, 3) unit vectors, evenly over a disc of the sphere."""
    if half_deg <= 0:
        return middle[None]
    k = np.arange(count) + 0.5
    z, phi = (
        1 - (1 - np.cos(np.radians(half_deg))) * k / count,
        k * np.pi * (3 - np.sqrt(5)),
    )
    r = np.sqrt(1 - z * z)
    return np.stack([r * np.cos(phi), r * np.sin(phi), z], -1) @ axes_about(middle).T


def axes_about(z: np.ndarray) -> np.ndarray:
    """(3, 3) rotation whose third column is the unit vector z."""
    x = np.cross([0.0, 1, 0] if abs(z[1]) < 0.9 else [1.0, 0, 0], z)
    x = x / np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z], -1)


def about(axis: np.ndarray, angle: float) -> np.ndarray:
    """(3, 3) turn about a unit axis, radians."""
    x, y, z = axis
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k


def near(
    rng: np.random.Generator, pole: np.ndarray, least_deg: float, most_deg: float
) -> np.ndarray:
    """(3,) unit at an angle from the pole between two, even over that band."""
    z, phi = (
        rng.uniform(*np.cos(np.radians([most_deg, least_deg]))),
        rng.uniform(0, 2 * np.pi),
    )
    r = np.sqrt(1 - z * z)
    return axes_about(pole) @ np.array([r * np.cos(phi), r * np.sin(phi), z])


def drawn(case: Case, seed: int, frames: int = FRAMES) -> Clip:
    """A clip of the case. Equal arguments give equal clips."""
    rng = np.random.default_rng([seed, *case.name.encode()])
    times = np.arange(frames) / FPS
    pole = np.array([0.0, 0, 1]) if case.motion == HELD else np.array([0.0, 0, -1])
    turns, places = (
        _held(rng, frames) if case.motion == HELD else _by_hand(rng, case, times)
    )
    strength = rng.uniform(0.4, 0.6)
    lamps = _lamps(rng, case, pole, strength, frames)
    ambient = strength * rng.uniform(*case.ambient) * rng.uniform(0.85, 1, 3)
    sky, middle = _sky(rng, pole, ambient, rng.uniform(*case.gradient))
    stops, period = rng.uniform(*case.drift_stops), rng.uniform(2, 6)
    bias = rng.uniform(*case.bias)
    clip = Clip(
        case, seed, times, turns, places, _prints(rng, case.prints), lamps, ambient, sky,
        2.0 ** (stops * np.sin(2 * np.pi * (times / period + rng.uniform()))), bias, rng.uniform(*case.gamma),
        rng.uniform(*case.gloss), rng.uniform(*case.noise_grey),
        (stops, period), middle if case.gradient[1] else None,
    )  # fmt: skip
    brightest = np.quantile(
        [
            clip.gain[k] * clip.irradiance(n, k).max()
            for k in range(0, frames, 3)
            for n in clip_normals(clip, k)
        ],
        1 - case.over,
    )
    wanted = (1.0 if case.over else rng.uniform(0.6, 0.92)) - bias
    clip.gain = clip.gain * wanted / (0.88 * brightest)
    return clip


def clip_normals(clip: Clip, frame: int) -> list[np.ndarray]:
    """Static axes, of the prints that face the camera in a frame."""
    turn, place, out = clip.turns[frame], clip.places_m[frame], []
    for rotation, at in clip.prints.values():
        n, p = turn @ rotation[:, 2], turn @ at + place
        if n @ p < -0.2 * np.linalg.norm(p):
            out.append(n if clip.camera_rests else rotation[:, 2])
    return out


def _by_hand(
    rng: np.random.Generator, case: Case, times: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """A print before a camera at rest: its tilt goes to and fro between two, towards where
    the hand turns it.
    """
    least, most = (np.radians(rng.uniform(*r)) for r in case.tilt_deg)
    if case.motion == AT_REST:
        least = most = np.radians(rng.uniform(0, 50))
    rate, phase, spin = (
        rng.uniform(*case.rate_hz),
        rng.uniform(0, 2 * np.pi, 3),
        rng.uniform(-0.4, 0.4),
    )
    goes = 0.5 - 0.5 * np.cos(2 * np.pi * rate * times + phase[0])
    towards = phase[1] + rng.choice([-1, 1]) * rng.uniform(0.8, 1.5) * times
    if case.motion == ROCKED:
        goes, towards, least = 2 * goes - 1, phase[1] + 0.02 * np.sin(times), 0.0
    if case.motion == AT_REST:
        towards, spin = phase[1] + 0 * times, 0.0
    tilt = least + (most - least) * goes
    level = np.diag([1.0, -1.0, -1.0])
    turns = np.array([
        about(np.array([np.cos(a), np.sin(a), 0]), t) @ level @ about(np.array([0.0, 0, 1]), phase[2] + spin * s)
        for a, t, s in zip(towards, tilt, times, strict=True)
    ])  # fmt: skip
    sway = 0.03 * np.stack(
        [
            np.sin(0.9 * times + phase[0]),
            np.sin(1.3 * times + phase[1]),
            np.sin(0.7 * times),
        ],
        -1,
    )
    sway = 0 * sway if case.motion == AT_REST else sway
    return turns, np.array([0, 0, DISTANCE_M]) + sway


def _held(rng: np.random.Generator, frames: int) -> tuple[np.ndarray, np.ndarray]:
    """A camera on an arc about the anchor, with a hand's tremor."""
    start, sweep = rng.uniform(-160, -140), rng.uniform(80, 140)
    azimuth = np.radians(start + sweep * np.linspace(0, 1, frames))
    elevation = np.radians(np.linspace(*rng.uniform(32, 55, 2), frames))
    turns, places = [], []
    for a, e, shake in zip(
        azimuth, elevation, 0.003 * rng.normal(size=(frames, 3)), strict=True
    ):
        back = np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
        z = -back
        x = np.cross(z, [0.0, 0, 1])
        x = x / np.linalg.norm(x)
        turn = np.stack([x, np.cross(z, x), z])
        turns.append(
            about(shake / np.linalg.norm(shake), float(np.linalg.norm(shake))) @ turn
        )
        places.append(np.array([0, 0, DISTANCE_M]))
    return np.array(turns), np.array(places)


def _prints(
    rng: np.random.Generator, kind: str
) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    out = {KEY: (np.eye(3), np.zeros(3))}
    if kind == "board":
        for key, side in zip(ON_CUBE[:2], (-1, 1), strict=True):
            tilt = about(
                np.array([0.0, 1, 0]), side * np.radians(rng.uniform(25, 45))
            )
            out[key] = (tilt, np.array([side * 0.11, 0, 0.02]))
    if kind == "tilted":
        for key, a in zip(
            ON_CUBE[:3],
            np.radians([-90, -20, 200]) + rng.uniform(-0.3, 0.3, 3),
            strict=True,
        ):
            tilt = about(
                np.array([-np.sin(a), np.cos(a), 0]), np.radians(rng.uniform(25, 50))
            )
            out[key] = (tilt, np.array([0.12 * np.cos(a), 0.12 * np.sin(a), 0.03]))
    if kind == "cube":
        turn, at = (
            about(np.array([0.0, 0, 1]), rng.uniform(-0.6, 0.6)),
            np.array([-0.13, 0.06, CUBE_M / 2]),
        )
        faces = (
            ([1.0, 0, 0], [0.0, 0, 1]),
            ([0.0, 1, 0], [0.0, 0, 1]),
            ([0.0, -1, 0], [0.0, 0, 1]),
            ([1.0, 0, 0], [0.0, 1, 0]),
        )
        for key, (x, y) in zip(ON_CUBE, faces, strict=True):
            own = turn @ np.stack([x, y, np.cross(x, y)], -1)
            out[key] = (own, at + own[:, 2] * (CUBE_M / 2 + 2e-4))
    return out


def _lamps(
    rng: np.random.Generator,
    case: Case,
    pole: np.ndarray,
    strength: float,
    frames: int,
) -> list[Lamp]:
    on, half, distance = (
        np.ones(frames),
        rng.uniform(*case.size_deg),
        rng.uniform(*case.near_m),
    )
    first = near(rng, pole, 15, 70)
    tint, lamps = rng.uniform(0.8, 1, 3), []
    if case.lamps:
        lamps = [Lamp(first, strength * tint, on, distance, half)]
    if case.lamps == 2:
        apart = rng.uniform(*case.apart_deg)
        second = near(rng, first, apart, apart)
        while second @ pole < np.cos(np.radians(75)):
            second = near(rng, first, apart, apart)
        other = tint if rng.uniform() < 0.5 else rng.uniform(0.6, 1, 3)
        ratio = rng.uniform(*case.ratio)
        lamps = [
            Lamp(first, strength * tint / (1 + ratio), on, distance, half),
            Lamp(second, strength * other * ratio / (1 + ratio), on, distance, half),
        ]
    if case.change:
        late = np.arange(frames) >= frames // 2
        early = ~late if rng.uniform() < 0.5 else late
        second = near(rng, pole, 15, 70)
        while second @ first > np.cos(np.radians(25)):
            second = near(rng, pole, 15, 70)
        lamps = [Lamp(first, strength * tint, early.astype(float), distance, half)]
        if case.change == "moved":
            lamps.append(
                Lamp(second, strength * tint, (~early).astype(float), distance, half)
            )
    return lamps


def _sky(
    rng: np.random.Generator, pole: np.ndarray, ambient: np.ndarray, share: float
) -> tuple[tuple[np.ndarray, np.ndarray], np.ndarray]:
    """Ambient light, of which a share comes from one side, a slope, or a window 40 to 80
    degrees wide; and that side's middle.
    """
    directions = sphere(1200)
    middle = near(rng, pole, 20, 100)
    c = directions @ middle
    side = (
        np.clip(c, 0, None)
        if rng.uniform() < 0.5
        else (c > np.cos(np.radians(rng.uniform(20, 40)))).astype(float)
    )
    weight = (1 - share) + share * side / side.mean()
    return (directions, weight[:, None] * ambient * (4 / len(directions))), middle
