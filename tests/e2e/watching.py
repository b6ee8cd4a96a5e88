"""`gaitway watch --open` as a user runs it."""

import os
import subprocess
import sys
from pathlib import Path

from gaitway.client import Client


def watching(client: Client, job_id: str, asked: Path) -> "subprocess.Popen[str]":
    """The command in a process of its own. asked: where its browser writes the address that it is to open."""
    browser = asked.with_name("browser")
    browser.write_text(f'#!/bin/sh\necho "$1" >> {asked}\n')
    browser.chmod(0o755)
    program = "from gaitway.cli.main import app; app()"
    command = [sys.executable, "-c", program, "--url", str(client.base_url), "watch", job_id, "--open"]
    environment = {**os.environ, "BROWSER": str(browser)}
    return subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True)
