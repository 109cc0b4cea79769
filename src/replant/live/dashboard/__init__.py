"""The dashboard: one page that shows a running identification, served to this machine's browser."""

from replant.live.dashboard.hub import Hub
from replant.live.dashboard.server import Dashboard, serve

__all__ = ["Dashboard", "Hub", "serve"]
