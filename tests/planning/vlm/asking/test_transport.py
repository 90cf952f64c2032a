"""All conversations share a loop and a client, and no reply is read without end."""

from __future__ import annotations

import asyncio
import importlib.util
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import httpx2
import pytest

from dream.planning.vlm.asking import transport


def test_threads_that_ask_at_once_share_a_loop_and_a_client(monkeypatch: pytest.MonkeyPatch) -> None:
    def slowly(make: Callable[..., Any]) -> Callable[..., Any]:
        def made(*args: Any, **options: Any) -> Any:
            time.sleep(0.05)
            return make(*args, **options)

        return made

    monkeypatch.setattr(asyncio, "new_event_loop", slowly(asyncio.new_event_loop))
    monkeypatch.setattr(httpx2, "AsyncClient", slowly(httpx2.AsyncClient))
    spec = importlib.util.find_spec(transport.__name__)
    assert spec is not None
    assert spec.loader is not None
    fresh = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(fresh)
    with ThreadPoolExecutor(4) as threads:
        assert len(set(threads.map(lambda _: fresh.loop(), range(4)))) == 1
        assert len(set(threads.map(lambda _: fresh.http_client(address=True, near=True), range(4)))) == 1
    assert fresh.http_client(address=True, near=False) is not fresh.http_client(address=True, near=True)


def test_a_proxy_stands_before_other_machines_only() -> None:
    for address in (True, False):
        assert not transport.http_client(address=address, near=True).trust_env
        assert transport.http_client(address=address, near=False).trust_env
