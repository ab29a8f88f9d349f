"""Nothing that the page shows leaves for another host: no view asks one, and the policy of the page blocks it."""

from __future__ import annotations

from typing import Any
from urllib.parse import urlsplit

import pytest

from fixtures.browser import Stage
from fixtures.browser_actions import go_to

VIEWS = (
    "#/drive/fan-1",
    "#/drive/fan-1?tab=parameters",
    "#/buses",
    "#/buses/fans",
    "#/alarms",
    "#/alarms?tab=incidents",
    "#/history?tags=fan-1",
    "#/audit",
    "#/models/vc660",
    "#/settings?tab=users",
    "#/settings?tab=tokens",
    "#/settings?tab=about",
)
FOREIGN = "http://127.0.0.2:9"
ATTEMPTS = {
    "connect-src": f"fetch('{FOREIGN}/').catch(() => 0)",
    "img-src": f"new Image().src = '{FOREIGN}/x.png'",
    "form-action": f"Object.assign(document.body.appendChild(document.createElement('form')),"
    f" {{method: 'post', action: '{FOREIGN}/'}}).submit()",
    "script-src-elem": f"document.head.appendChild(document.createElement('script')).src = '{FOREIGN}/x.js'",
}


def test_the_page_sends_nothing_to_another_host(stage: Stage, visit: Any) -> None:
    page = visit("#/fleet", role="administrator")
    hosts = set()
    page.on("request", lambda request: hosts.add(urlsplit(request.url).netloc))
    page.on("websocket", lambda socket: hosts.add(urlsplit(socket.url).netloc))
    page.reload()
    for view in VIEWS:
        go_to(page, view)
        page.wait_for_timeout(200)
    assert hosts == {urlsplit(stage.at).netloc}


@pytest.mark.parametrize("directive", ATTEMPTS)
def test_the_policy_of_the_page_blocks_what_a_script_would_send_elsewhere(scripts: Any, directive: str) -> None:
    violation = f"""() => new Promise(resolve => {{
        document.addEventListener("securitypolicyviolation",
            event => resolve(event.effectiveDirective), {{once: true}});
        {ATTEMPTS[directive]};
    }})"""
    assert scripts.evaluate(violation) == directive
