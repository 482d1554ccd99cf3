"""The places that a job writes to: held against all that it reads, locked while it runs,
and given back.
"""

import contextlib
from collections.abc import Iterator, Mapping
from pathlib import Path

from arfx.config.sections import JobConfig
from arfx.core.guard import Guard, check_file_name
from arfx.errors import ConfigError, InputError, JobInterruptedError, NothingToDoError
from arfx.media.output import image_names, names_sequence
from arfx.run.folder import JobFolder
from arfx.run.inputs import Inputs
from arfx.run.lock import locked

# How the files of a report begin: a file of that name that begins otherwise is not arfx's
PAGE_START = (
    '<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><meta name="generator"'
    ' content="arfx">'
)
REPORT_FILES = {"report.json": b'{\n "input": {', "report.html": PAGE_START.encode()}


def place(output: Path) -> Path:
    """The file, or the folder of images, that an output is. Raises ConfigError."""
    beside = output.absolute().parent if names_sequence(output) else output
    if not beside.name:
        raise ConfigError(
            f"images cannot be written into {beside} itself",
            "name a folder in it: frames/%06d.png",
        )
    return beside


def default_folder(output: Path) -> Path:
    """Where a job lives while it runs, beside its output: out.mp4 -> out.mp4.job,
    frames/%06d.png -> frames.job
    """
    beside = place(output)
    return beside.with_name(f"{beside.name}.job")


def files_read(inputs: Inputs) -> Iterator[tuple[str, Path]]:
    """(what it is, path) of every file and folder that a job reads: all paths of its
    configuration, and what those pull in.
    """
    yield from files_named(inputs.config)
    yield from (("file of the model", path) for path in inputs.model.files)
    yield from (
        ("depth map", path)
        for path in (() if inputs.depth is None else inputs.depth.files)
    )


def files_named(config: JobConfig) -> Iterator[tuple[str, Path]]:
    """(what it is, path) of every path of a configuration, and of the files that it was
    read from.
    """
    sections = [dict(s) for s in (config.input, config.model, config.pipeline)]
    sections += [vars(p) for p in config.params.values()]
    for key, value in (pair for section in sections for pair in section.items()):
        if isinstance(value, Path):
            yield "model" if key == "file" else key.replace("_", " "), value
    yield from (("pattern", p.image) for p in config.patterns)
    yield from (("job file", path) for path in config.sources)


@contextlib.contextmanager
def files_locked(
    guard: Guard, folder: Path, files: Mapping[str, bytes], option: str = "-o"
) -> Iterator[None]:
    """A folder in which only the body writes, these files: held against the guard before it
    is locked, and after.
    """
    guard.files(folder, files, option)
    with locked(folder, option):
        guard.files(folder, files, option)
        yield


class Places:
    """Where a job writes. folder : what can be resumed;  part : the output until it is
    whole, on the output's own disk

    named : the job folder, None = beside the output, and gone when the job is done;  report
    : folder of a report, if any
    """

    def __init__(
        self, inputs: Inputs, named: Path | None, report: Path | None, overwrite: bool
    ) -> None:
        self._output, self._report, self._overwrite = inputs.output, report, overwrite
        self._guard = Guard(files_read(inputs), overwrite)
        self._home = JobFolder(default_folder(inputs.output.path))
        self._named = named is not None
        self.folder = (
            self._home
            if named is None or named.resolve() == self._home.path.resolve()
            else JobFolder(named)
        )
        self.part = self._home.joined

    def check(self) -> None:
        """Refuse what would destroy or replace anything that it may not. Raises ConfigError."""
        self.check_output()
        for path in (self._output.path, self._report, self._home.path):
            if path is not None and (
                path is not self._home.path or self.folder is not self._home
            ):
                _outside(path, self.folder.path)
        if self._report is not None:
            _outside(self._report, self._home.path)
            self._guard.files(self._report, REPORT_FILES, "--report")
        if self.folder is not self._home:
            _outside(self.folder.path, self._home.path)
        for place in {self._home, self.folder}:
            self._guard.folder(place.path, "--job" if self._named else "-o")
            self._guard.check_not_read(
                place.timings
            )  # the one file that is added to, not replaced
            place.check_foreign_files()

    def check_output(self) -> None:
        path = self._output.path
        if self._output.is_sequence:
            check_file_name(path.with_name(path.name % 10**9))
            self._guard.images(
                path.absolute().parent, path.suffix, image_names(path.name)
            )
        else:
            self._guard.file(path)

    @contextlib.contextmanager
    def held(self, resume: bool) -> Iterator[None]:
        """The places checked, locked and made. A folder in which nothing can be resumed
        goes again, what else is in it stays.

        Raises ConfigError where a check fails, another process has one of them, or a job is
        there and it is neither to be resumed nor overwritten; RenderError where they cannot
        be made."""
        self._guard.own = self.folder.outputs() if resume else frozenset()
        self.check()
        with contextlib.ExitStack() as stack:
            stack.enter_context(
                locked(
                    self._home.path,
                    "-o",
                    temporary=not self._named or self.folder is not self._home,
                )
            )
            if self.folder is not self._home:
                stack.enter_context(locked(self.folder.path, "--job"))
            if self._report is not None:
                stack.enter_context(locked(self._report, "--report"))
            self.check()  # a job that has ended in between changed what is there
            self.folder.check(resume, self._overwrite)
            self.folder.open(resume)
            try:
                yield
            except JobInterruptedError:
                raise
            except BaseException as e:
                same_end = isinstance(e, NothingToDoError) or (
                    isinstance(e, (ConfigError, InputError)) and not resume
                )
                if (
                    same_end
                ):  # another try with the same command would not get further
                    self.folder.clear("stretches/")
                if not self.folder.resumable:
                    self.folder.clear()
                raise
            if not self._named:
                self.folder.clear()


def _outside(path: Path, folder: Path) -> None:
    if folder.resolve() in (path.resolve(), *path.resolve().parents):
        raise ConfigError(
            f"{path} lies in the job folder {folder}, which is arfx's own",
            "name another place",
        )
