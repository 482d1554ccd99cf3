"""Build step beside pyproject.toml: the presets of configs/ go into the wheel as
arfx/config/presets/.
"""

import shutil
from pathlib import Path

from setuptools import setup
from setuptools.command.build_py import build_py


class BuildWithPresets(build_py):
    def run(self) -> None:
        super().run()
        if self.editable_mode:
            return  # an editable install reads configs/ where it lies
        target = Path(self.build_lib) / "arfx" / "config" / "presets"
        target.mkdir(parents=True, exist_ok=True)
        for preset in sorted((Path(__file__).parent / "configs").glob("*.toml")):
            shutil.copy2(preset, target / preset.name)


setup(cmdclass={"build_py": BuildWithPresets})
