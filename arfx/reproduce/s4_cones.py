"""Step 4 of Yao, Tao, Wu 2018: cones over the hemisphere and what they bring."""

from __future__ import annotations

from functools import partial

import numpy as np

from arfx.core.numerics import direction_of
from arfx.core.sampling import GOLDEN_RAD
from arfx.core.stage import JobView, Stage
from arfx.papers.s4_cones import WIDE_DEG, six_cones
from arfx.papers.s4_environment import step3_mipmap
from arfx.papers.s4_gi import PrintedGi, PrintedGiParams, Surfels, wide_cones
from arfx.reproduce.rows import Items, Row, row
from arfx.reproduce.s4_scenes import flat_with
from arfx.reproduce.s4_volumes import N, ray, small
from arfx.reproduce.work import Work
from arfx.run.summary import picture
from arfx.stages import STAGES
from arfx.stages.gi.gloss import mirror_tangent
from arfx.stages.gi.health import furnace_mean


def cones(work: Work) -> Items:
    directions, weights, _ = six_cones()
    narrow = np.degrees(np.arctan(mirror_tangent(0.1)))
    wide = WIDE_DEG
    yield row(
        "step 4, half-angle of the mirror cone at a roughness of 0.1",
        "a narrow cone",
        (narrow, narrow),
        "degrees",
        "it is not narrow",
        narrow < wide / 4,
    )
    yield row(
        "step 4, half-angle of the wide cones",
        "several wider cones",
        (wide, wide),
        "degrees",
        "one alone",
        len(weights) > 1,
    )
    total = weights.sum()
    yield row(
        "step 4, weights of the wide cones together",
        "1, as follows",
        (total, total),
        "",
        "not 1",
        abs(total - 1) < 1e-6,
    )
    k = np.arange(100_000)
    hemisphere = direction_of(k * GOLDEN_RAD, np.arcsin((k + 0.5) / len(k)))
    covered = ((hemisphere @ directions.T).max(1) > np.cos(np.radians(wide))).mean()
    yield row(
        "step 4, share of the hemisphere within the wide cones",
        "cover the whole hemisphere",
        (covered, covered),
        "of 1",
        "cones of 60° that cover it would overlap; these are tilted and weighted so that"
        " they leave as much of coarse and fine light as a cosine does",
        covered > 0.99,
    )
    yield through()
    yield from step_length()
    yield from furnace(work)


def through() -> Row:
    """The environment under a half opaque ceiling."""
    ceiling = np.argwhere(np.ones((N, N, 1))) + np.array([0, 0, 12])
    made = small(ceiling, 0.5)
    V = np.zeros((len(made.tree.eta), 3), np.float32)
    up = np.array([[0.0, 0.0, 1.0]])
    at = Surfels(np.full((1, 3), 8.0), up, -up)
    environment = step3_mipmap(np.full((6, 8, 8, 3), 0.5))
    red, _, _, left = wide_cones(made, V, at, (environment, np.eye(3)))[0]
    share = red / (0.5 * left)
    return row(
        "step 4, environment through a half opaque ceiling, over what cones let through",
        "weighted by what the cone hides",
        share,
        "",
        "not weighted so",
        abs(share - 1) < 1e-3 and left < 0.99,
    )


def step_length() -> Items:
    """Through a block of opacity and radiance one half."""
    block = np.argwhere(np.ones((N, N, N)))
    one, two, four, half = (
        np.array(ray(0.5, block, [[k * length, 0, length] for k in range(count)]))
        for count, length in ((1, 1.0), (2, 0.5), (4, 0.25), (1, 0.5))
    )
    yield row(
        "step 4, opacity of half a step where α = 0.5",
        "two of them make one step, as follows",
        1 - half[:, 3],
        "",
        "two make another",
        abs(half[:, 3] ** 2 - 0.5).max() < 1e-6,
    )
    yield row(
        "step 4, opacity of two half steps where α = 0.5",
        "that of one step, as follows",
        1 - two[:, 3],
        "",
        "another",
        abs(two[:, 3] - 0.5).max() < 1e-6,
    )
    brighter = four[:, 0] / one[:, 0]
    yield row(
        "step 4, light of a voxel that is passed in four steps, over one step",
        "not stated",
        brighter,
        "",
        "radiance counts whole at every step; corrected: in proportion to the step's"
        " opacity",
        brighter.max() < 1.01,
    )


def furnace(work: Work) -> Items:
    """A white ball on a white plane in an even light of 1 has to vanish.

    The short form has the smallest volume alone.
    """
    scene = flat_with(work, "ball", "8cm")

    def mean_with(gi: Stage) -> float:
        pictures = partial(picture, own={"gi": gi})
        mean = furnace_mean(JobView((), scene, {}, pictures), "standard")
        assert mean is not None
        return mean

    corrected = mean_with(STAGES["gi"]())
    for n in (32, 64, 128):
        if n == 32 or not work.short:
            printed = mean_with(
                PrintedGi(PrintedGiParams(voxels=n, plane_albedo=1.0))
            )
        means = np.array([printed, corrected])
        yield row(
            f"step 4, white furnace at {n}³ voxels",
            "1, as follows",
            means,
            "mean radiance",
            "voxels of the plane that hold the ball's foot leak, and its normals are means",
            abs(means - 1).max() < 0.02,
        )
