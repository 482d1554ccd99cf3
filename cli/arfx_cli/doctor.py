"""`arfx doctor`: what works here, and the fix for what does not."""

from __future__ import annotations

from pathlib import Path

import click

from arfx_cli.console import emit_json, json_option


@click.command()
@json_option
def command(as_json: bool) -> None:
    """Check Python, packages, renderer back ends, codecs, cores, memory and disk; say the fix for what does not work.

    Exits with 0 if clips can be processed here, with 5 if something essential fails.

    \b
    Example:
      arfx doctor
    """
    from arfx.errors import RenderError
    from arfx.measure.machine import examine, sound

    checks = examine(Path.cwd())
    if as_json:
        emit_json({"ok": sound(checks), "checks": [c.to_json() for c in checks]})
    else:
        for group in dict.fromkeys(c.group for c in checks):
            click.echo(group)
            for c in (c for c in checks if c.group == group):
                mark = click.style("ok  ", fg="green") if c.ok else click.style("no  ", fg="red" if c.essential else "yellow")
                click.echo(f"  {mark}{c.name:32}{c.detail}")
                if c.fix:
                    click.echo(f"      fix: {c.fix}")
    if not sound(checks):
        wrong = [c.name for c in checks if c.essential and not c.ok] or ["every renderer"]
        raise RenderError(f"arfx cannot work here: {', '.join(wrong)}", "the fixes stand beside each check")
    if not as_json:
        broken = [c.name for c in checks if not c.ok]
        click.echo("Clips can be processed here." + (f" Missing, not essential: {', '.join(broken)}." if broken else ""))
