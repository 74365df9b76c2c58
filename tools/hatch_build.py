"""Put the page's third-party files into the wheel, so that it needs no npm where it is used."""

import importlib.util
from pathlib import Path

from hatchling.builders.hooks.plugin.interface import BuildHookInterface


class VendorHook(BuildHookInterface):
    """Fetches the files; a wheel built without npm fetches them when the page is first shown."""

    def initialize(self, version: str, build_data: dict) -> None:
        """Fetch the files, and name them for the wheel; an editable install needs none."""
        if version == "editable":
            return
        file = Path(self.root, "quadwalk/web/vendor.py")
        spec = importlib.util.spec_from_file_location("vendor", file)
        vendor = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(vendor)
        folder = Path(self.root, "build", "page")
        try:
            vendor.fetch(folder)
        except vendor.FetchError as error:
            self.app.display_warning(str(error))
            return
        build_data["force_include"][str(folder / "vendor")] = "quadwalk/web/vendor"
