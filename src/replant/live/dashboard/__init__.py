"""The dashboard: a page that shows a running identification in a browser."""

from replant.live.dashboard.hub import Hub
from replant.live.dashboard.server import Dashboard, serve

__all__ = ["Dashboard", "Hub", "serve"]
