"""Make .venv with everything arfx needs. Standard library only; run by `make`, or as
`python3 tools/make_venv.py`.

Works with a bare Python >= 3.11: without ensurepip (Debian keeps it in python3-venv) pip
comes from the host's pip or, failing that, as a wheel from the package index, whose SHA-256
the index states. The second call is quick and needs no
network: a stamp in .venv holds the hash of everything that decides what is installed.

The first lines must be readable by any Python 3, so that an old one gets a message and not
a syntax error."""

# ruff: noqa: E402  (the version is looked at before anything that an old Python lacks)
import sys

OLDEST = (3, 11)
if sys.version_info < OLDEST:
    import shutil

    found = [
        name
        for name in ("python3.13", "python3.12", "python3.11")
        if shutil.which(name)
    ]
    sys.stderr.write(
        "arfx needs Python 3.11 or newer; %s is %s\n"  # noqa: UP031
        % (sys.executable, sys.version.split()[0])
        + "help: %s\n"
        % (
            "make PYTHON=" + found[0]
            if found
            else "install python3.11, then make PYTHON=python3.11"
        )
    )
    sys.exit(2)

import configparser
import hashlib
import html
import json
import os
import platform
import re
import shutil
import ssl
import subprocess
import tempfile
import urllib.error
import urllib.parse
import urllib.request
import venv
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
VENV = ROOT / ".venv"
STAMP = VENV / "arfx-installed.json"
CONSTRAINTS = ROOT / "constraints.txt"
DECIDING = ("pyproject.toml", "setup.py", "constraints.txt", "tools/make_venv.py")
DEFAULT_INDEX = "https://pypi.org/simple"


def fail(message: str, hint: str) -> "SystemExit":
    sys.stderr.write(f"make_venv: {message}\nhelp: {hint}\n")
    return SystemExit(1)


def wanted_stamp() -> dict[str, str]:
    """What decides the installation: the files' contents, the Python, and where the tree
    lies (scripts hold its path).
    """
    digest = hashlib.sha256()
    for name in DECIDING:
        path = ROOT / name
        digest.update(
            name.encode()
            + b"\0"
            + (path.read_bytes() if path.exists() else b"")
            + b"\0"
        )
    return {
        "inputs": digest.hexdigest(),
        "python": platform.python_version(),
        "root": str(ROOT),
    }


def venv_python() -> Path:
    return (
        VENV
        / ("Scripts" if os.name == "nt" else "bin")
        / ("python.exe" if os.name == "nt" else "python")
    )


def read_stamp() -> dict[str, str]:
    try:
        stamp = json.loads(STAMP.read_text())
    except (OSError, ValueError):
        return {}
    return stamp if isinstance(stamp, dict) else {}


def runs(*command: object) -> bool:
    try:
        return (
            subprocess.run(
                [str(c) for c in command], capture_output=True, timeout=120
            ).returncode
            == 0
        )
    except (OSError, subprocess.TimeoutExpired):
        return False


def usable(stamp: dict[str, str], wanted: dict[str, str]) -> bool:
    """May the environment that lies there be kept (and brought up to date)? Not after a
    move or with another Python.
    """
    moved = any(stamp.get(k, wanted[k]) != wanted[k] for k in ("root", "python"))
    same = f"import sys; sys.exit(sys.version_info[:3] != {sys.version_info[:3]!r})"
    return not moved and runs(venv_python(), "-c", same)


def pip_setting(name: str) -> "str | None":
    """A setting of pip's, from its environment variable or its configuration files, as pip
    itself would see it.
    """
    value = os.environ.get("PIP_" + name.upper().replace("-", "_"))
    if value:
        return value
    home = Path.home() if "HOME" in os.environ else Path("/nonexistent")
    files = [
        "/etc/xdg/pip/pip.conf",
        "/etc/pip.conf",
        home / ".pip" / "pip.conf",
        home / ".config" / "pip" / "pip.conf",
    ]
    files.append(os.environ.get("PIP_CONFIG_FILE") or os.devnull)
    parser = configparser.RawConfigParser(strict=False)
    try:
        parser.read([str(f) for f in files])
    except (configparser.Error, UnicodeDecodeError):
        return None
    for section in ("install", "global"):
        if parser.has_option(section, name):
            return parser.get(section, name).strip()
    return None


def open_url(url: str, accept: str = "*/*") -> bytes:
    certificates = pip_setting("cert") or os.environ.get("SSL_CERT_FILE")
    context = ssl.create_default_context(
        cafile=certificates if certificates and Path(certificates).is_file() else None
    )
    request = urllib.request.Request(
        url, headers={"Accept": accept, "User-Agent": "arfx-make-venv"}
    )
    try:
        with urllib.request.urlopen(request, timeout=120, context=context) as answer:
            body: bytes = answer.read()
            return body
    except (urllib.error.URLError, OSError) as e:
        raise fail(
            f"cannot fetch {urllib.parse.urlsplit(url).hostname}:"
            f" {getattr(e, 'reason', e)}",
            "the first set-up needs the network (PIP_INDEX_URL and PIP_CERT are honoured),"
            " or pip: apt-get install python3-venv",
        ) from None


def wheels_on(page: bytes, url: str) -> "list[tuple[tuple[int, ...], str, str]]":
    """(version, address with hash, file name) of the pip wheels on a simple-index page
    (JSON or HTML) for this Python.
    """
    text = page.decode("utf-8", "replace")
    if text.lstrip().startswith("{"):
        rows = [
            (
                f["filename"],
                f["url"] + "#sha256=" + f.get("hashes", {}).get("sha256", ""),
                f.get("requires-python") or "",
            )
            for f in json.loads(text)["files"]
            if not f.get("yanked")
        ]
    else:
        rows = []
        for attributes, name in re.findall(r"<a\s([^>]*)>([^<]*)</a>", text):
            href = re.search(r'href="([^"]*)"', attributes)
            needs = re.search(r'data-requires-python="([^"]*)"', attributes)
            if href and "data-yanked" not in attributes:
                rows.append(
                    (
                        name.strip(),
                        html.unescape(href[1]),
                        html.unescape(needs[1]) if needs else "",
                    )
                )
    out = []
    for name, address, needs in rows:
        version = re.fullmatch(
            r"pip-(\d+(?:\.\d+)*)-py3-none-any\.whl|pip-(\d+(?:\.\d+)*)-py2\.py3-none-any\.whl",
            name,
        )
        least = re.search(r">=\s*3\.(\d+)", needs)
        if version and not (least and int(least[1]) > sys.version_info[1]):
            number = tuple(int(p) for p in (version[1] or version[2]).split("."))
            out.append((number, urllib.parse.urljoin(url, address), name))
    return sorted(out)


def bootstrap_pip() -> None:
    """pip into a virtual environment that has none, from a wheel of the package index."""
    index = (pip_setting("index-url") or DEFAULT_INDEX).rstrip("/") + "/pip/"
    accept = (
        "application/vnd.pypi.simple.v1+json, application/vnd.pypi.simple.v1+html;q=0.2,"
        " text/html;q=0.1"
    )
    wheels = wheels_on(open_url(index, accept), index)
    if not wheels:
        raise fail(
            f"no pip wheel for Python {platform.python_version()} on {index}",
            "apt-get install python3-venv, then make again",
        )
    _, address, name = wheels[-1]
    address, _, fragment = address.partition("#")
    body = open_url(address)
    stated = fragment.removeprefix("sha256=")
    if stated and hashlib.sha256(body).hexdigest() != stated:
        raise fail(
            f"{name} does not have the SHA-256 that the index states",
            "try again; a proxy may have changed it",
        )
    with tempfile.TemporaryDirectory() as folder:
        wheel = Path(folder) / name
        wheel.write_bytes(body)
        subprocess.run(
            [
                str(venv_python()),
                str(wheel / "pip"),
                "install",
                "-q",
                "--no-index",
                str(wheel),
            ],
            check=True,
        )


def create() -> None:
    """An empty .venv with pip in it: by ensurepip, by the host's pip, or from the index."""
    if VENV.exists() and any(VENV.iterdir()) and not (VENV / "pyvenv.cfg").exists():
        raise fail(f"{VENV} exists and is no virtual environment", "move it away")
    print(
        f"make_venv: making {VENV} with Python {platform.python_version()}",
        flush=True,
    )
    shutil.rmtree(VENV, ignore_errors=True)
    venv.EnvBuilder(symlinks=os.name != "nt", with_pip=False).create(VENV)
    if runs(venv_python(), "-m", "ensurepip", "--upgrade", "--default-pip"):
        return
    print(
        "make_venv: this Python has no ensurepip; fetching pip another way",
        flush=True,
    )
    if runs(
        sys.executable, "-m", "pip", "--python", venv_python(), "install", "-q", "pip"
    ):
        return
    bootstrap_pip()


def pip_install(*more: str) -> "tuple[int, str]":
    """Exit status and what was printed, which is also shown as it comes."""
    command = [
        str(venv_python()),
        "-m",
        "pip",
        "install",
        "--disable-pip-version-check",
        "--progress-bar",
        "off",
        *more,
    ]
    process = subprocess.Popen(
        command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )
    assert process.stdout
    lines = []
    for line in process.stdout:
        lines.append(line)
        if line.startswith(("Collecting", "Successfully", "ERROR", "error")):
            print("  " + line.rstrip()[:160], flush=True)
    return process.wait(), "".join(lines)


def install() -> None:
    """The project, editable, with its development tools, at the versions of constraints.txt
    where they exist here.
    """
    status, said = pip_install("-c", str(CONSTRAINTS), "-e", ".[dev,cluster]")
    unresolved = re.search(
        r"ResolutionImpossible|No matching distribution|Could not find a"
        r" version|Requires-Python",
        said,
    )
    if (
        status
        and unresolved
        and not re.search(
            r"NewConnectionError|Temporary failure|Network is unreachable", said
        )
    ):
        print(
            f"make_venv: constraints.txt does not fit Python {platform.python_version()} here; installing the newest versions "
            "that pyproject.toml allows instead", flush=True,
        )  # fmt: skip
        status, said = pip_install("-e", ".[dev,cluster]")
    if status:
        sys.stderr.write(said[-3000:])
        raise fail(
            "pip could not install arfx (its last lines are above)",
            "check the network and the free disk, then run it again",
        )


def main() -> int:
    wanted, stamp = wanted_stamp(), read_stamp()
    if stamp == wanted and venv_python().exists():
        return 0
    if not (
        VENV.exists()
        and usable(stamp, wanted)
        and runs(venv_python(), "-m", "pip", "--version")
    ):
        create()
    STAMP.unlink(missing_ok=True)
    install()
    aside = STAMP.with_suffix(".part")
    aside.write_text(json.dumps(wanted))
    aside.replace(STAMP)
    print(f"make_venv: ready; {VENV.relative_to(ROOT)}/bin/arfx --help", flush=True)
    return 0


if __name__ == "__main__":
    try:
        sys.exit(main())
    except PermissionError as e:
        sys.exit(
            fail(
                f"may not write {e.filename}",
                "run it as the user who owns the folder",
            ).code
        )
    except KeyboardInterrupt:
        sys.exit(130)
