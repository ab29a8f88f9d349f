"""A plant that is none: answers the contract's JSON from memory, so that the page is tried without buses and drives.

``python tests/web/page/fakeplant.py [PORT] [DRIVES]`` serves it by hand; user ``ada``, password ``a good password``.
"""

from __future__ import annotations

import asyncio
import json
import math
import sys
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

from fastapi import FastAPI, HTTPException, Request, WebSocket, WebSocketDisconnect
from fastapi.responses import FileResponse, JSONResponse
from fastapi.staticfiles import StaticFiles

from drivebus import i18n
from drivebus.plant.access.rights import RIGHTS, Role

Json = dict[str, Any]
WEB = Path(i18n.__file__).parents[1] / "web"
CSP = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; connect-src 'self'; "
    "font-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
NAMES = [
    ("Supply fan", "送风机"), ("Exhaust fan", "排风机"), ("Feed pump", "给水泵"), ("Circulation pump", "循环泵"),
    ("Mixer", "搅拌机"), ("Belt", "皮带机"), ("Screw", "螺旋输送机"), ("Compressor", "空压机"),
]  # fmt: skip
MODELS = ["c320", "dzb100", "vc660", "df800"]
BADGES = [("trips", 3.0), ("runs_on", None), ("unknown", None)]


def both(en: str, zh: str) -> Json:
    return {"en": en, "zh": zh}


def said(key: str, **params: Any) -> Json:
    return both(i18n.text(key, "en", **params), i18n.text(key, "zh", **params))


class Refused(Exception):
    def __init__(self, status: int, kind: str, text: Json, code: str = "fake.refused") -> None:
        super().__init__(code)
        self.status = status
        self.body = {
            "code": code, "kind": kind, "text": text, "params": {}, "outcome": None, "status": status,
        }  # fmt: skip


class FakePlant:
    """Drives, groups, buses and alarms as dictionaries; ``changed`` collects what the next delta tells."""

    def __init__(self, drives: int = 12) -> None:
        self.topics: dict[str, Json] = {}
        self.changed: dict[str, Json] = {}
        self.asked: list[tuple[str, Json]] = []
        self.alarms: list[Json] = []
        self.role = Role.ADMINISTRATOR
        self.needs_setup = False
        self.started = time.monotonic()
        for n in range(drives):
            self._add(n)
        lines = sorted({self.drive(f"drive-{n}")["bus"] for n in range(drives)})
        for line in lines:
            self.topics[f"buses/{line}"] = self._bus(line)
        for group in ("hall-a", "hall-b"):
            self.topics[f"groups/{group}"] = self._group(group)
        self.topics["plant"] = {
            "id": "fake", "title": both("Water works", "水厂"), "state": "running", "stop_all": None,
            "version": "0", "started_ms": self.now_ms(), "audit_ok": True, "history_ok": True, "disk": {},
        }  # fmt: skip
        self.topics["alarms"] = {"active": []}

    def now_ms(self) -> int:
        return time.time_ns() // 1_000_000

    def _add(self, n: int) -> None:
        kind, after = BADGES[n % 3] if n else BADGES[0]
        name = NAMES[n % len(NAMES)]
        self.topics[f"drives/drive-{n}"] = {
            "id": f"drive-{n}", "bus": f"line-{n % 4 + 1}", "address": n // 4 + 1, "model": MODELS[n % 4],
            "grade": "bench", "presence": "online", "state": "running" if n % 3 else "stopped", "state_reason": None,
            "direction": "forward", "fault": None, "commanded_hz": 30.0, "minimum_hz": 0.0, "maximum_hz": 50.0,
            "latched": False, "stop_pending": False, "title": both(f"{name[0]} {n + 1}", f"{name[1]} {n + 1} 号"),
            "capabilities": ["run", "stop", "jog", "reset", "set_frequency"] + ["coast"] * (n % 2),
            "groups": ["hall-a" if n % 2 == 0 else "hall-b"],
            "host_dies": {"kind": kind, "after_s": after, "text": both("as read", "已读取"), "waiver": None},
            "lease": None, "blocked": [], "alarms": {}, "signals": self._signals(n, 0.0),
        }  # fmt: skip
        if kind != "trips":
            self.drive(f"drive-{n}")["blocked"] = [
                {"key": "plant.waiver_needed", "params": {}, "text": both("needs a waiver", "需要豁免")}
            ]

    def _signals(self, n: int, hz: float) -> Json:
        def one(value: float | None, unit: str, quality: str = "good", reason: str | None = None) -> Json:
            return {"value": value, "unit": unit, "quality": quality, "reason": reason, "age_s": 0.05}

        return {
            "output_frequency": one(round(hz, 2), "Hz"),
            "output_current": one(round(hz / 12 + n % 5 * 0.1, 2), "A"),
            "dc_bus_voltage": one(537, "V"),
            "set_frequency": one(30.0, "Hz"),
        }

    def _bus(self, line: str) -> Json:
        stations = [view for name, view in self.topics.items() if name.startswith("drives/") and view["bus"] == line]
        return {
            "id": line, "title": both(line.replace("-", " ").title(), line), "link": "/dev/ttyUSB0", "line": "9600 8E1",
            "is_open": True, "load_percent": 41.0, "occupied_percent": 47.0, "transactions_per_s": 22.5,
            "error_rate": 0.002, "errors": {"timeout": 2}, "counters": {}, "reply_p50_s": 0.02, "reply_p95_s": 0.03,
            "reply_p99_s": 0.04, "foreign_master": False, "stop_bound_s": 0.09, "stations": [
                {"address": view["address"], "drive": view["id"], "presence": view["presence"], "refresh_s": 0.4,
                 "error_rate": 0.001, "reply_p50_s": 0.02, "reply_p95_s": 0.03, "errors": {}, "counters": {},
                 "load_percent": 10.0} for view in stations],
        }  # fmt: skip

    def _group(self, id: str) -> Json:
        drives = [view["id"] for view in self.drives() if id in view["groups"]]
        title = both(id.replace("-", " ").title(), "甲厂房" if id == "hall-a" else "乙厂房")
        return {
            "id": id, "title": title, "drives": drives, "leader": drives[0] if drives else None, "ratios": {},
            "state": "mixed", "progress": None,
        }  # fmt: skip

    def drives(self) -> list[Json]:
        return [view for name, view in self.topics.items() if name.startswith("drives/")]

    def drive(self, id: str) -> Json:
        try:
            return self.topics[f"drives/{id}"]
        except KeyError:
            raise Refused(404, "NotFound", both(f"no drive {id}", f"没有变频器 {id}")) from None

    def change(self, topic: str, **fields: Any) -> None:
        """Lay ``fields`` over a topic, as the next delta tells it."""
        self.topics[topic].update(fields)
        self.changed.setdefault(topic, {}).update(fields)

    def trip(self, id: str) -> None:
        """A drive trips, and its alarm is raised."""
        fault = {
            "code": 4, "label": "E.OC1", "text": both("overcurrent while accelerating", "加速过电流"),
            "cause": both("ramp too short", "加速时间过短"), "remedy": both("lengthen the ramp", "延长加速时间"),
        }  # fmt: skip
        self.change(f"drives/{id}", state="fault", fault=fault, alarms={"urgent": 1})
        self.alarms.append(
            {
                "id": f"fault-{id}-1", "setting": "fault", "drive": id, "priority": "urgent", "kind": "fault",
                "title": both("Fault E.OC1", "故障 E.OC1"), "text": fault["text"], "raised_ms": self.now_ms(),
                "cleared_ms": None, "acknowledged_ms": None, "by": None, "shelved_until_ms": None, "value": 4,
                "case": "case-1",
            }
        )  # fmt: skip
        self.change("alarms", active=self.alarms)

    def live_values(self, part: int, parts: int) -> None:
        """Every ``parts``-th drive has a new value."""
        t = time.monotonic() - self.started
        for n, view in enumerate(self.drives()):
            if n % parts == part:
                turning = view["state"] == "running"
                hz = view["commanded_hz"] + 0.2 * math.sin(t + n) if turning else 0.0
                self.change(f"drives/{view['id']}", signals=self._signals(n, hz))

    def delta(self) -> Json:
        topics, self.changed = self.changed, {}
        return topics

    # What can be asked ---------------------------------------------------------------------------------------------

    def outcome(self, key: str, word: str = "confirmed", **params: Any) -> Json:
        frame = {"sent": "01 06 20 00 00 01", "received": "01 06 20 00 00 01", "sent_at_s": 1.0, "received_at_s": 1.02}
        return {
            "word": word, "key": key, "text": said(key, **params), "params": {}, "notes": [], "command": "run-1",
            "frames": [frame | {"error": None}],
        }  # fmt: skip

    def do(self, id: str, what: str, body: Json) -> Json:
        """One command to one drive."""
        self.asked.append((f"{id} {what}", body))
        view, topic = self.drive(id), f"drives/{id}"
        if what == "lease":
            lease = {"owner": "ada", "session": "s-1", "expires_in_s": 10.0}
            self.change(topic, lease=lease)
            return {"lease": lease, "ttl_s": 10}
        if what == "stop":
            self.change(topic, state="stopped")
            return {"outcome": self.outcome("drives.stopped", state="stopped")}
        if what == "waiver":
            self.change(topic, host_dies={**view["host_dies"], "waiver": body["reason"]}, blocked=[])
            return {"host_dies": view["host_dies"]}
        if view["lease"] is None:
            raise Refused(409, "NotOwner", both("take control first", "请先取得控制权"))
        if what == "arm":
            return {"arm": "arm-1", "expires_s": 10}
        if what == "jog":
            self.change(topic, state="jogging")
            return {"jog": "jog-1", "lease_s": 0.5, "outcome": self.outcome("drives.jog_begun", "acknowledged")}
        if what == "jog/end":
            self.change(topic, state="stopped")
        if what == "run":
            if body.get("arm") != "arm-1":
                raise Refused(409, "ArmNeeded", both("arm first", "请先确认"))
            self.change(topic, state="running", commanded_hz=body["frequency_hz"], direction=body.get("direction"))
        if what == "set-frequency":
            if body["frequency_hz"] > view["maximum_hz"]:
                text = said("drives.above_maximum", frequency_hz=body["frequency_hz"], limit_hz=50.0)
                raise Refused(422, "LimitError", text, "drives.above_maximum")
            self.change(topic, commanded_hz=body["frequency_hz"])
        if what == "reset":
            self.change(topic, state="stopped", fault=None)
            for alarm in self.alarms:
                alarm["cleared_ms"] = self.now_ms()
        return {"outcome": self.outcome("drives.stopped", state="stopped")}

    def stop_all(self, ids: list[str]) -> Json:
        outcomes = {id: self.do(id, "stop", {})["outcome"] for id in ids}
        buses = {name.removeprefix("buses/"): {"confirmed": True, "unconfirmed": [], "took_s": 0.2}
                 for name in self.topics if name.startswith("buses/")}  # fmt: skip
        return {"buses": buses, "outcomes": outcomes}

    def acknowledge(self, id: str) -> Json:
        for alarm in self.alarms:
            if alarm["id"] == id:
                alarm.update(acknowledged_ms=self.now_ms(), by="ada")
        self.alarms = [alarm for alarm in self.alarms if not (alarm["acknowledged_ms"] and alarm["cleared_ms"])]
        self.change("alarms", active=self.alarms)
        return {}

    def session(self, logged_in: bool) -> Json:
        user = {"name": "ada", "role": str(self.role)} if logged_in else None
        rights = sorted(RIGHTS[self.role]) if logged_in else []
        return {
            "user": user, "rights": rights, "session": "s-1" if logged_in else None, "csrf": "c-1",
            "setup": self.needs_setup,
        }  # fmt: skip


def make_app(plant: FakePlant) -> FastAPI:
    """The contract's routes over ``plant``; the page's files as the real service has them."""
    stopping = asyncio.Event()

    @asynccontextmanager
    async def life(_: FastAPI) -> AsyncIterator[None]:
        turning = asyncio.create_task(_turn(plant, stopping))
        yield
        turning.cancel()

    app = FastAPI(lifespan=life, openapi_url=None)

    @app.middleware("http")
    async def headers(request: Request, go_on: Any) -> Any:
        answer = await go_on(request)
        answer.headers["Content-Security-Policy"] = CSP
        answer.headers["Cache-Control"] = "no-store"
        return answer

    @app.exception_handler(Refused)
    async def refused(_: Request, error: Refused) -> JSONResponse:
        return JSONResponse({"error": error.body}, error.status)

    _who(app, plant)
    _commands(app, plant)
    _live(app, plant)

    @app.get("/i18n/{language}.json")
    async def catalogue(language: str) -> Json:
        return dict(i18n.catalogue(language))

    @app.get("/")
    async def index() -> FileResponse:
        return FileResponse(WEB / "static" / "index.html")

    app.mount("/static", StaticFiles(directory=WEB / "static"))
    app.mount("/vendor", StaticFiles(directory=WEB / "vendor"))
    return app


async def _turn(plant: FakePlant, stopping: asyncio.Event) -> None:
    part = 0
    while not stopping.is_set():
        await asyncio.sleep(0.25)
        plant.live_values(part, 4)
        part = (part + 1) % 4


def _who(app: FastAPI, plant: FakePlant) -> None:
    @app.get("/api/v1/session")
    async def session(request: Request) -> Json:
        return plant.session("drivebus_session" in request.cookies)

    @app.post("/api/v1/login")
    async def login(request: Request) -> JSONResponse:
        body = await request.json()
        if body != {"name": "ada", "password": "a good password"}:
            raise Refused(401, "NotLoggedIn", both("wrong name or password", "用户名或密码错误"))
        answer = JSONResponse({})
        answer.set_cookie("drivebus_session", "s-1", httponly=True, samesite="strict")
        return answer

    @app.post("/api/v1/logout")
    async def logout() -> JSONResponse:
        answer = JSONResponse({})
        answer.delete_cookie("drivebus_session")
        return answer


def _commands(app: FastAPI, plant: FakePlant) -> None:
    @app.post("/api/v1/drives/{drive}/{what:path}")
    async def command(drive: str, what: str, request: Request) -> Json:
        return plant.do(drive, what, await request.json())

    @app.delete("/api/v1/drives/{drive}/lease")
    async def release(drive: str) -> Json:
        plant.change(f"drives/{drive}", lease=None)
        return {}

    @app.post("/api/v1/stop")
    async def stop() -> Json:
        return plant.stop_all([view["id"] for view in plant.drives()])

    @app.post("/api/v1/groups/{group}/stop")
    async def stop_group(group: str) -> Json:
        return plant.stop_all(plant.topics[f"groups/{group}"]["drives"])

    @app.post("/api/v1/alarms/{alarm}/acknowledge")
    async def acknowledge(alarm: str) -> Json:
        return plant.acknowledge(alarm)

    @app.get("/api/v1/{path:path}")
    async def other(path: str) -> Json:
        raise HTTPException(404, path)


def _live(app: FastAPI, plant: FakePlant) -> None:
    @app.websocket("/api/v1/live")
    async def live(socket: WebSocket) -> None:
        await socket.accept()
        seq = 1
        message: Json = {"type": "snapshot", "seq": seq, "time_ms": plant.now_ms(), "topics": plant.topics}
        try:
            while True:
                await socket.send_text(json.dumps(message))
                await asyncio.sleep(0.25)
                seq += 1
                message = {
                    "type": "delta", "seq": seq, "time_ms": plant.now_ms(), "topics": plant.delta(), "gone": [],
                }  # fmt: skip
        except (WebSocketDisconnect, RuntimeError):
            return


if __name__ == "__main__":
    import uvicorn

    port, drives = int((sys.argv[1:2] or ["8099"])[0]), int((sys.argv[2:3] or ["12"])[0])
    uvicorn.run(make_app(FakePlant(drives)), host="127.0.0.1", port=port, log_level="warning")
