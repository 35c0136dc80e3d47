"""Pictures of the pages that a replay writes: their first screens, as a browser shows them. Needs Chromium.

`python docs/generate/page_pictures.py` draws them; fonts differ between machines, so no test holds them equal.
"""

import subprocess
import sys
import tempfile
from base64 import b64decode
from pathlib import Path

from written import PROJECT

sys.path.insert(0, str(PROJECT / "tests"))
from browser import opened_browser  # after its folder is known

SAMPLE = PROJECT / "sample_logs" / "figure_eight.mcap"
ARCHIVE = PROJECT / "examples" / "archive" / "dives"
# The commands that write pages into a folder, and the page of each picture.
PAGES = {
    "page_of_a_dive": (["run", f"{SAMPLE}", "-q"], "figure_eight/report.html"),
    "page_of_dives": (["run", f"{ARCHIVE}", "-q"], "index.html"),
    "page_of_a_change": (["demo"], "lever_arm.html"),
}
WIDTH_PX = 1366
HEIGHT_PX = 640


def main() -> None:
    """Run the commands, and save the first screen of each page."""
    with tempfile.TemporaryDirectory() as name, opened_browser(Path(name) / "profile") as browser:
        for picture, (words, page) in PAGES.items():
            command = [sys.executable, "-m", "insdvl_replay", *words, "-o", picture]
            subprocess.run(command, cwd=name, check=True, capture_output=True)
            browser.open(Path(name) / picture / page, WIDTH_PX)
            clip = {"x": 0, "y": 0, "width": WIDTH_PX, "height": HEIGHT_PX, "scale": 1}
            found = browser.call("Page.captureScreenshot", format="png", clip=clip)
            (PROJECT / "docs" / f"{picture}.png").write_bytes(b64decode(found["data"]))


if __name__ == "__main__":
    main()
