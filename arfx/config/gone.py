"""Settings that are gone, each with what to write instead: the help of the error that names one."""

from __future__ import annotations

from collections.abc import Mapping

_PRINTED = 'it belongs to watercolor.formula = "paper"; the corrected edges take {0}'
_SEARCH = "prints are looked for as their size and motion ask: leave it out"
_LIGHT_MAP = 'it belongs to light.formula = "paper": leave it out'
GONE: Mapping[tuple[str | int, ...], str] = {
    ("analyse", "search_interval_s"): _SEARCH,
    ("analyse", "loss_search_frames"): _SEARCH,
    ("analyse", "reduced_search_every"): _SEARCH,
    ("analyse", "reduced_px"): _SEARCH,
    ("analyse", "min_side_px"): "prints are found from 9 px on: leave it out",
    ("analyse", "transfer"): "it is told by the edges of the first prints: leave it out",
    ("analyse", "fade_frames"): "the object fades over 5 frames: leave it out",
    ("light", "albedos"): "`light.ink` and `light.paper` say what a print reflects",
    (
        "light",
        "limit_deg",
    ): "it is 15; `light.claims` sets whether likely lights are used",
    ("light", "drift_per_s"): "it is .05: leave it out",
    ("light", "window_s"): "it is 2 s: leave it out",
    ("light", "map_level"): _LIGHT_MAP,
    ("light", "map_blur_rad"): _LIGHT_MAP,
    (
        "lightmap",
        "faint",
    ): "a shadow that takes less than 2 % of the plane's light is not drawn",
    ("lightmap", "ambient"): "a job with gi gives that light itself: leave it out",
    ("gi", "plane_roughness"): "it is .1; `plane_gloss` sets how much the plane mirrors",
    ("dof", "plane_extent_m"): "the plane is endless; `background_m` says where it ends",
    ("dof", "max_radius_px"): "the radius is at most a tenth of the picture's width",
    ("watercolor", "detail"): "cells always follow what there is to see: leave it out",
    (
        "watercolor",
        "anchored",
    ): "cells always move with the things under them: leave it out",
    ("watercolor", "two_patterns"): "one pattern is painted: leave it out",
    (
        "watercolor",
        "line_hold",
    ): "lines hold still by themselves; a higher line_high steadies more",
    (
        "watercolor",
        "line_smooth_px",
    ): "it is 3 px; a higher line_low leaves fine lines out",
    ("watercolor", "alpha"): _PRINTED.format(".5"),
    ("watercolor", "beta"): _PRINTED.format(".5"),
    ("watercolor", "yuv"): _PRINTED.format("bt601"),
    (
        "watercolor",
        "pigment",
    ): "set flow, grain, edge_darkening and wobble_px to 0 for flat cells",
    ("watercolor", "flow_px"): "it is 160 px; `flow` sets how strong the turbulence is",
    (
        "watercolor",
        "grain_px",
    ): "it is 2 px; `grain` sets how strong the paper's grain is",
    ("watercolor", "dry_brush"): "`grain` sets how much the paper shows, in lines too",
}
