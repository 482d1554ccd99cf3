"""Rows of Tan, Chen, Sun 2009: illumination from a dynamic light map.

Equations on readings made for it (s1_equations), figures and table 1 on scenes (s1_scenes).
The reference of a picture is the corrected method at its highest level, told the true
lamp."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import cv2
import numpy as np

from arfx.core.cube import look_up
from arfx.core.layers import Layer
from arfx.core.light import DirectionalLight, Light, triple
from arfx.core.numerics import angle_between, divide, normalise
from arfx.measure.difference import level_difference
from arfx.media.models import load_model
from arfx.papers import CORRECTED, PAPER
from arfx.papers.s1_light import PrintedLightParams, hemisphere, triangles, upright
from arfx.papers.s1_lightmap import printed_map
from arfx.reproduce import s1_equations
from arfx.reproduce.rows import (
    BEFORE,
    DIFFERS,
    HOLDS,
    REFERENCE,
    Bars,
    Figure,
    Item,
    Row,
    row,
)
from arfx.reproduce.rows import CORRECTED as CORRECTED_PICTURE
from arfx.reproduce.rows import PRINTED as PRINTED_PICTURE
from arfx.reproduce.s1_scenes import AMBIENT, SITUATIONS, Lamp, turned_card
from arfx.reproduce.work import Settings, Shot, Work

NO_SHADOW: Settings = {"lightmap": {"shadow_strength": 0.0, "self_shadow": 0.0}}
HEMISPHERE_PX = 320  # a side of its picture
# between neighbouring triangles' middles: a direction cannot be found better by peaks
NEAR_DEG = 8.0
TABLE_1 = {  # model: faces, frames per second, MB
    "apple": (4000, (9, 13), 60),
    "teapot": (6000, (9, 12), 64),
    "aeroplane": (21000, (8, 10), 77),
}
LUMPS = (
    "M has a cusp (8) at every normal that was shown and is in units of the first picture's"
    " light (ρ as brightness); lights are its peaks (9), and what a shadow takes is not"
    " printed"
)


def rows(work: Work) -> Iterator[Item]:
    yield from s1_equations.rows(work)
    situations = [Situation(work, lamp) for lamp in SITUATIONS]
    yield from equation_3(situations[0])
    yield from figure_1(situations[0])
    yield from figure_2(situations[0])
    yield from figure_3(situations)
    yield from table_1(work)


class Situation:
    """A clip under one lamp, and its last frame as the methods render it."""

    def __init__(self, work: Work, lamp: Lamp) -> None:
        self.work, self.lamp = work, lamp
        size_px, frames = work.scaled((320, 240), (160, 120)), work.scaled(40, 14)
        self.clip = work.clip(turned_card(lamp, size_px, frames))
        self.last = frames - 1
        self._pictures: dict[str, dict[str, np.ndarray]] = {}
        self.model = model_file(work, work.scaled("teapot", "cube"))

    def shot(self, formula: str, settings: Settings) -> Shot:
        return self.work.shot(self.clip, self.last, formula, {**self.model, **settings})

    def pictures(self, settings: Settings) -> dict[str, np.ndarray]:
        if (key := repr(settings)) not in self._pictures:
            given = {
                "given": [self.lamp.azimuth_deg, self.lamp.elevation_deg, *self.lamp.rgb],
                "size_deg": 2.0,
            }
            quality = self.work.scaled("reference", "standard")
            best: dict[str, Any] = {
                **settings,
                "light": given,
                "pipeline": {"quality": quality},
            }
            self._pictures[key] = {
                BEFORE: self.clip.frames()[self.last],
                PRINTED_PICTURE: self.shot(PAPER, settings).picture(),
                CORRECTED_PICTURE: self.shot(CORRECTED, settings).picture(),
                REFERENCE: self.shot(CORRECTED, best).picture(),
            }
        return self._pictures[key]

    def lamp_in_world(self, shot: Shot) -> np.ndarray:
        """In the card's axes in the last frame; the room's are the card's in the first. The
        camera rests.
        """
        first, last = (shot.job.facts[k].pose.rotation for k in (0, self.last))
        return np.asarray(last.T @ first @ self.lamp.towards)

    def off_deg(self, shot: Shot) -> float:
        """Of the brightest light."""
        light = max(facts_light(shot).lights, key=lambda li: sum(li.rgb))
        return float(np.degrees(angle_between(light.unit, self.lamp_in_world(shot))))


def model_file(work: Work, name: str) -> Settings:
    """The job's settings for a model of `models`; its camera rests, as the paper's does."""
    return {"model": {"file": work.model(name)}, "analyse": {"static": "camera"}}


def facts_light(shot: Shot) -> Light:
    light = shot.facts.light
    assert light is not None  # every frame with a pose has one
    return light


def equation_3(situation: Situation) -> Iterator[Item]:
    """I(v) = g rho_v M(n_v) + b, on the picture's own layers; highlights are beside (3)."""
    off: list[float] = []
    for formula in (PAPER, CORRECTED):
        shot = situation.shot(
            formula, {"lightmap": {**NO_SHADOW["lightmap"], "plane_blocks": False}}
        )
        facts, on = shot.facts, shot.layer(Layer.COVERAGE) > 0.999
        n, rho, virtual = (
            shot.layer(name)[on] for name in (Layer.NORMAL, Layer.ALBEDO, Layer.VIRTUAL)
        )
        found = printed_map(facts.light_map)
        M = (
            facts_light(shot).radiance(n)
            if found is None
            else look_up(found[0], n @ found[1].T)
        )
        expected = rho * M + np.array(facts.bias_rgb)
        off.append(
            100 * float(np.median(np.abs(virtual - expected)) / np.median(expected))
        )
    yield row(
        "equation (3), difference of the object's pixels, highlights included, median",
        "I = g ρ M(n) + b",
        off,
        "%",
        "highlights, and reflections of the room",
        max(off) < 5,
    )


def figure_1(situation: Situation) -> Iterator[Item]:
    item, level = "figure 1, triangles of the hemisphere", PrintedLightParams().map_level
    yield row(item, "a hemisphere of triangles", len(hemisphere(level)), "", "", True)
    shots = {
        PRINTED_PICTURE: situation.shot(PAPER, {}),
        CORRECTED_PICTURE: situation.shot(CORRECTED, {}),
    }
    yield row(
        "figure 1, lights of a scene with one lamp",
        "1",
        tuple(len(facts_light(s).lights) for s in shots.values()),
        "",
        s1_equations.PEAKS,
    )
    off = tuple(situation.off_deg(s) for s in shots.values())
    yield row(
        "section 4, direction of the lamp: degrees off",
        "accurate",
        off,
        "degrees",
        s1_equations.PEAKS,
        max(off) < NEAR_DEG,
    )
    printed = shots[PRINTED_PICTURE]
    found = printed_map(printed.facts.light_map)
    assert found is not None
    cube, map_from_world = found
    middles = hemisphere(level)  # the map's axes
    world = middles @ map_from_world
    true = Light(
        AMBIENT,
        (DirectionalLight(triple(situation.lamp_in_world(printed)), situation.lamp.rgb),),
    )
    values = {
        PRINTED_PICTURE: look_up(cube, middles),
        CORRECTED_PICTURE: facts_light(shots[CORRECTED_PICTURE]).radiance(world),
        REFERENCE: true.radiance(world),
    }
    lamps = {
        PRINTED_PICTURE: facts_light(printed),
        CORRECTED_PICTURE: facts_light(shots[CORRECTED_PICTURE]),
        REFERENCE: true,
    }
    yield Figure(
        item,
        "candidate lights seen from above, each as bright as the map there over the map's"
        " largest; those that are lights have a red border",
        {
            name: drawn_hemisphere(
                level,
                M,
                np.array([map_from_world @ li.unit for li in lamps[name].lights]),
            )
            for name, M in values.items()
        },
    )


def drawn_hemisphere(level: int, M: np.ndarray, lights: np.ndarray) -> np.ndarray:
    """(side, side, 3) R'G'B': the triangles from above, as bright as M (k, 3); those
    nearest to `lights` (l, 3) bordered red.
    """
    faces = triangles(level)
    middles = normalise(faces.mean(1))
    turn = upright(middles[-1])
    upper = (middles @ turn.T)[:, 2] >= 0
    corners = (faces[upper] @ turn.T)[..., :2] * [1, -1]
    points = np.round((1 + 0.97 * corners) / 2 * HEMISPHERE_PX * 16).astype(
        np.int32
    )  # in 16ths of a pixel
    picture = np.full((HEMISPHERE_PX, HEMISPHERE_PX, 3), 255, np.uint8)
    grey = np.clip(divide(M, M.max()), 0, 1) * 255
    for triangle, colour in zip(points, grey.tolist(), strict=True):
        cv2.fillConvexPoly(picture, triangle, colour, cv2.LINE_AA, 4)
        cv2.polylines(picture, [triangle], True, (90, 90, 110), 1, cv2.LINE_AA, 4)
    for d in lights:
        cv2.polylines(
            picture,
            [points[int((hemisphere(level) @ d).argmax())]],
            True,
            (230, 30, 30),
            2,
            cv2.LINE_AA,
            4,
        )
    return picture


def errors(pictures: Mapping[str, np.ndarray]) -> tuple[float, float]:
    """Mean difference of the printed and the corrected picture from the reference, where
    any of them changes the plate.
    """
    apart = [
        level_difference(picture, pictures[BEFORE])
        for name, picture in pictures.items()
        if name != BEFORE
    ]
    on = np.max(apart, 0) > 2
    printed, corrected = (
        level_difference(pictures[REFERENCE], pictures[k])[on]
        for k in (PRINTED_PICTURE, CORRECTED_PICTURE)
    )
    return float(printed.mean()), float(corrected.mean())


def pictures_row(item: str, printed: str, pictures: Mapping[str, np.ndarray]) -> Row:
    off = errors(pictures)
    return row(item, printed, off, "grey levels from the reference", LUMPS, max(off) < 3)


def figure_2(situation: Situation) -> Iterator[Item]:
    for part, what, settings in (
        ("a", "shading without shadow", NO_SHADOW),
        ("b", "shading and shadow", {}),
    ):
        pictures = situation.pictures(settings)
        yield pictures_row(f"figure 2 ({part})", what, pictures)
        yield Figure(
            f"figure 2 ({part})", f"{what}; the teapot stands on the card", pictures
        )


def figure_3(situations: list[Situation]) -> Iterator[Item]:
    for part, situation in zip("ab", situations, strict=True):
        pictures = situation.pictures({})
        a, e = situation.lamp[:2]
        yield pictures_row(f"figure 3 ({part})", "the shadow of one situation", pictures)
        yield Figure(
            f"figure 3 ({part})",
            f"lamp at azimuth {a:g}, elevation {e:g} degrees",
            pictures,
        )


def table_1(work: Work) -> Iterator[Item]:
    size_px, frames = work.scaled((640, 480), (128, 96)), work.scaled(20, 4)
    clip = work.clip(turned_card(SITUATIONS[0], size_px, frames, samples=1))
    rates: dict[str, list[Any]] = {"printed": [], "printed method": [], "corrected": []}
    memory: dict[str, list[Any]] = {name: [] for name in rates}
    for name, (faces, (low, high), size_mb) in TABLE_1.items():
        count = load_model(work.model(name)).face_count
        yield row(f"table 1, {name}, faces", str(faces), (count, count))
        timed = [
            work.timed(clip, formula, model_file(work, name))
            for formula in (PAPER, CORRECTED)
        ]
        fps, mb = tuple(t.frames_per_s for t in timed), tuple(t.peak_mb for t in timed)
        verdict = HOLDS if all(low <= rate <= high for rate in fps) else DIFFERS
        yield row(
            f"table 1, {name}, frame rate",
            f"{low}–{high}",
            fps,
            "frames/s",
            f"this machine and pictures of {size_px[0]} x {size_px[1]}; the paper names"
            " neither its machine nor its pictures' size. Decoding, analysing, rendering"
            " and encoding are counted",
            verdict == HOLDS,
        )
        yield row(
            f"table 1, {name}, memory",
            str(size_mb),
            (mb[0], mb[1]),
            "MB",
            f"{timed[0].start_mb:.0f} MB are Python and its libraries before the job;"
            " frames that wait for a worker are the rest",
        )
        for series, values in ((rates, ((low, high), *fps)), (memory, (size_mb, *mb))):
            for key, value in zip(series, values, strict=True):
                series[key].append(value)
    least = tuple(min(rates[key]) for key in ("printed method", "corrected"))
    yield row(
        "section 3, least frame rate",
        "8",
        least,
        "frames/s",
        "not every model reaches the printed rate on this machine",
        min(least) >= 8,
    )
    labels = [f"{name}, {faces:,} faces" for name, (faces, *_) in TABLE_1.items()]
    yield Bars(
        "table 1, apple, frame rate", "frame rate", "frames per second", labels, rates
    )
    yield Bars("table 1, apple, memory", "memory", "MB", labels, memory)
