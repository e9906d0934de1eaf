"""Settings of what the server writes to its log."""

from __future__ import annotations

from typing import Literal

from revnm_server.settings.section import Section


class LogSettings(Section):
    """The log, on standard error: lines for people, or a JSON object a line for whoever collects them."""

    level: Literal["debug", "info", "warning", "error"] = "info"
    format: Literal["text", "json"] = "text"
