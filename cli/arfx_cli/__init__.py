"""The command line of arfx: main and one thin file per command."""
