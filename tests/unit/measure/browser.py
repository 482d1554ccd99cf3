"""Opens a page in a headless Chromium, does things to it, and reads what it became.

For tests of the HTML reports.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
from html import unescape
from pathlib import Path
from typing import Any

NAMES = (
    "chromium",
    "chromium-browser",
    "google-chrome",
    "google-chrome-stable",
    "chrome",
)
WHY = "no Chromium here (looked for " + ", ".join(NAMES) + "; CHROME names one)"


def browser() -> str | None:
    return os.environ.get("CHROME") or next(
        (path for name in NAMES if (path := shutil.which(name))), None
    )


def opened(page: Path, work: Path, script: str) -> dict[str, Any]:
    """What `script`, the body of a function, returns in the page once that has loaded; with
    "errors" : what went wrong in it.

    No network: every name but the file itself resolves to nothing. The page is copied, with
    the probe added, into `work`."""
    found = browser()
    assert found is not None
    text = page.read_text(encoding="utf-8")
    early = """<script>window.__bad = [];
      addEventListener("error", e => __bad.push(String(e.message || e.target.src || e)), true);
      const old = console.error; console.error = (...a) => { __bad.push(a.join(" ")); old(...a); };</script>"""
    late = f"""<script>addEventListener("load", () => setTimeout(() => {{
      const told = (() => {{ {script} }})(); told.errors = window.__bad;
      const out = document.createElement("pre"); out.id = "told"; out.textContent = JSON.stringify(told);
      document.body.append(out); }}, 50));</script>"""
    copy = work / "probed.html"
    copy.write_text(
        text.replace("<head>", "<head>" + early, 1).replace(
            "</body>", late + "</body>", 1
        ),
        encoding="utf-8",
    )
    command = [
        found, "--headless=new", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--no-first-run",
        "--host-resolver-rules=MAP * ~NOTFOUND", f"--user-data-dir={work / 'profile'}", "--virtual-time-budget=4000",
        "--window-size=1100,900", "--dump-dom", copy.resolve().as_uri(),
    ]  # fmt: skip
    with subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    ) as started:
        try:
            out, err = started.communicate(timeout=240)
        except subprocess.TimeoutExpired:
            os.killpg(
                started.pid, signal.SIGKILL
            )  # its helpers too: they hold the pipes open and keep the cores busy
            out, err = started.communicate()
    told = re.search(r'<pre id="told">(.*?)</pre>', out, re.DOTALL)
    assert told, f"the page never finished: {out[-500:]} {err[-500:]}"
    return dict(json.loads(unescape(told[1])))
