"""A dashboard being served, fed from a simulated plant."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from replant.live.dashboard.server import Dashboard, serve
from support.browsing import chromium
from support.dashboard_feed import Feed
from support.dashboard_pages import Page


@pytest.fixture(scope="session")
def watched() -> Iterator[tuple[Feed, Dashboard]]:
    """A feed, and its dashboard on a free port."""
    feed = Feed()
    with serve(feed.hub) as served:
        yield feed, served


@pytest.fixture
def feed(watched: tuple[Feed, Dashboard]) -> Feed:
    """The feed: it has found its plant, has just published, and has heard no command yet."""
    feed = watched[0]
    if not feed.adapting:
        feed.obey("adapt")
    feed.forget()
    feed.settle()
    return feed


@pytest.fixture
def dashboard(watched: tuple[Feed, Dashboard], feed: Feed) -> Dashboard:
    """The dashboard of the feed."""
    return watched[1]


@pytest.fixture(scope="module")
def browser() -> Iterator:
    """The system's Chromium; not for longer than a module: its loop would stand in the way of others."""
    with chromium() as launched:
        yield launched


@pytest.fixture
def opened(browser, dashboard: Dashboard, feed: Feed) -> Iterator[Page]:
    """The page, which must not have complained by the end."""
    page = Page(browser, dashboard.url)
    yield page
    page.close()
    assert page.complaints == []
