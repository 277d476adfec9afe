# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The atlas in a browser: a contributor uploads, a moderator accepts, a visitor finds the site."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from pathlib import Path

import pytest
from atlas_run import make_site, running
from conftest import ROOT
from PIL import Image

PATIENCE = 300  # seconds for the whole tour on a busy computer


def test_a_site_goes_from_the_upload_page_to_the_map(tmp_path: Path) -> None:
    """In headless Chromium, on a desktop and on a phone."""
    chromium = os.environ.get("CHROMIUM") or shutil.which("chromium") or shutil.which("chromium-browser")
    if chromium is None:
        pytest.skip("NOT TESTED in a browser: no chromium; apt-get install chromium, or set CHROMIUM")
    if not (ROOT / "web" / "node_modules" / "playwright-core").is_dir():
        pytest.skip("NOT TESTED in a browser: no playwright-core; npm ci --prefix web")
    site = make_site(tmp_path / "p", "<b>Round</b> House")
    (tmp_path / "pictures").mkdir()
    with running(tmp_path / "atlas") as atlas:
        links = [atlas.run("invite", role).strip() for role in ("contributor", "moderator")]
        ran = subprocess.run(
            ["node", ROOT / "tests" / "web" / "atlas.mjs", chromium, f"{atlas.address}/", *links, site.parent,
             tmp_path / "pictures"], capture_output=True, text=True, timeout=PATIENCE, check=False)
    assert ran.returncode == 0, ran.stderr
    found = json.loads(ran.stdout)
    assert not found["wrong"], "\n".join(found["wrong"])
    assert "<b>Round</b> House" in found["mine"] and "Conrad" in found["held"] and found["list"] == 1
    assert found["cookies"] == [[True, "Strict"]] and found["visitors"] == 0 and found["wide"] <= 390
    assert found["forbidden"] == 403  # a contributor who opens the moderators' page
    for text in ("CN-1113", "1700 – 1750", "earth, 圆楼", "<b>Round</b> House"):
        assert text in found["about"], found["about"]
    assert found["embed"].startswith("<iframe ") and f'src="{atlas.address}/sites/' in found["embed"]
    assert found["chinese"] == "遗址" and found["refusal"] == "名称或密码错误。"
    for name in ("map", "search", "site", "upload", "moderate", "phone_map_chinese", "phone_site_chinese"):
        with Image.open(tmp_path / "pictures" / f"{name}.png") as picture:
            assert len(set(picture.convert("RGB").resize((200, 200)).getdata())) > 100, f"{name} shows nothing"
