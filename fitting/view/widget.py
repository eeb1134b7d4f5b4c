"""The live view in a notebook: the same front-end as the page, as a widget."""

from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path
from typing import Any

import anywidget
import traitlets

from .live import Live

PAGE = Path(str(files("merlfit.fitting.view").joinpath("page")))


class View(anywidget.AnyWidget):
    """Sliders, spheres and lobes of results.

    Attributes:
        values: of the parameters of each result that differ from it, by name, as `Fit.edited` takes them; they follow
            the sliders.
    """

    _esm = PAGE / "view.js"
    _css = PAGE / "view.css"
    about = traitlets.Dict().tag(sync=True)
    values = traitlets.List(traitlets.Dict())

    def __init__(self, live: Live) -> None:
        super().__init__(about=live.about, values=[{} for _ in live.shown])
        self._live = live
        self.on_msg(self._heard)

    def _heard(self, _: object, message: Mapping[str, Any], buffers: object) -> None:
        found = self._live.answer(message)
        if message.get("ask") == "frame" and "error" not in found:
            each = self._live.shown[message["result"]]
            changed = each.changes(message["values"])
            self.values = [changed if k == message["result"] else x for k, x in enumerate(self.values)]
        self.send(found)
