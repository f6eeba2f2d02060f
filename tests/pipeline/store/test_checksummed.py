"""Small files of the store are written alike by every process."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[3]
WRITE = """
import sys
from pathlib import Path
from pipeline.store.checksummed import write_text_whole

write_text_whole(Path(sys.argv[1]), "K\\u00fcche", Path(sys.argv[2]))
"""


def test_texts_are_written_in_utf_8_whatever_the_locale(tmp_path: Path) -> None:
    """What is damaged in a bucket may hold any text, and is kept as it is."""
    environment = {**os.environ, "LC_ALL": "C", "PYTHONCOERCECLOCALE": "0", "PYTHONUTF8": "0"}
    words = [sys.executable, "-c", WRITE, str(tmp_path / "text"), str(tmp_path / "aside")]
    subprocess.run(words, cwd=ROOT, env=environment, check=True)
    assert (tmp_path / "text").read_text(encoding="utf-8") == "Küche"
