"""`arfx reproduce`: every equation, printed number and figure of the four papers beside
what the program gives.

Each paper has a module with one function, `rows(work)`, which yields a `Row` for every
equation, number (each cell of a table) and figure, and a `Figure` or `Plot` of the same
item where the paper has one (`rows`). `work` makes the scenes and jobs that they are
computed from (`work.Work`). To add an item: yield it, and record its verdict in
tests/unit/reproduce/verdicts."""

from typing import NamedTuple


class Paper(NamedTuple):
    """authors : as it is cited;  title : translated;  module : its rows"""

    authors: str
    title: str
    module: str


PAPERS = {
    "s1": Paper(
        "Tan, Chen, Sun 2009",
        "Illumination Method in Augmented Reality Based on Dynamic Light Map",
        "arfx.reproduce.s1",
    ),
    "s2": Paper(
        "Zhao et al. 2012",
        "Luminance and Depth Based Real-time Depth of Field Rendering Algorithm",
        "arfx.reproduce.s2",
    ),
    "s3": Paper(
        "Jia, Tang 2013",
        "The watercolor style real-time augmented reality technology",
        "arfx.reproduce.s3",
    ),
    "s4": Paper(
        "Yao, Tao, Wu 2018",
        "A single-lens mixed reality method that combines environment mapping and global"
        " illumination",
        "arfx.reproduce.s4",
    ),
}
