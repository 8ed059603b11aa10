"""Devices played back from a log of ``rig record``: chips and servos that answer, and talkers."""

import os
import threading
from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from typing import Any

from sim.devices.dynamixel_packet import HEADER, Instruction, Request, RequestReader
from sim.devices.pty_port import PtyPort
from sim.replay.registers import RESERVED, set_up_answer
from sim.replay.response_lookup import RecordedExchange, ResponseLookup, recorded_epoch

NO_ACKNOWLEDGE = 121
LISTENER_S = 0.3
"""Delay from the opening of the port to the first byte: listeners discard earlier input."""

GOAL_POSITION = 116
"""Register address in X-series servos; a write moves the head."""

NEAR_TICKS = 11
"""Tolerance for goals: those computed from noisy readings differ, and within 1 degree count as the recorded one."""

FIRST_OF_A_LINE = b"$!\x01"

Exchange = Mapping[str, Any]
Say = Callable[[str], None]


def with_epochs(exchanges: Sequence[Exchange]) -> Iterator[tuple[Exchange, int]]:
    """Each exchange with its epoch: the number of goals given to the head before it."""
    epoch = 0
    for exchange in exchanges:
        epoch += "sent" in exchange and _is_goal(bytes.fromhex(exchange["sent"]))
        yield exchange, epoch


def _is_goal(sent: bytes) -> bool:
    return any(
        request.instruction in (Instruction.WRITE, Instruction.SYNC_WRITE)
        and int.from_bytes(request.parameters[:2], "little") == GOAL_POSITION
        for request in RequestReader().feed(sent)
    )


class ReplayedChip:
    """A chip that repeats its recorded answers. Implements ``sim.devices.i2c_chip.I2cChip``.

    A read contained in a recorded longer one is answered from that: the registers are the same. Unrecorded requests get
    no acknowledge; ``say`` is called.
    """

    def __init__(
        self,
        address: int,
        exchanges: Sequence[tuple[Exchange, int]],
        epoch: Callable[[], int] = lambda: 0,
        say: Say = lambda what: None,
    ) -> None:
        self.address = address
        self._say = say
        self._recorded: ResponseLookup[Exchange] = ResponseLookup(
            [
                RecordedExchange((bytes.fromhex(e["write"]), e["length"]), e, not e["length"], at)
                for e, at in exchanges
            ],
            epoch,
            cut_polls_go_on=True,
        )

    def transfer(self, write: bytes, read_length: int) -> bytes:
        """See ``I2cChip``."""
        exchange, skipped = self._recorded.answer((write, read_length)), 0
        if exchange is None:
            for longer, begin in self._covering(write, read_length):
                exchange, skipped = self._recorded.answer(longer), begin
                break
        if exchange is None:
            if (self.address, write, read_length) not in RESERVED:
                self._say(
                    f"holds no transfer that writes {write.hex(' ') or 'nothing'} and reads {read_length} bytes"
                )
            exchange = {"errno": NO_ACKNOWLEDGE}
        if "errno" in exchange:
            raise OSError(exchange["errno"], os.strerror(exchange["errno"]))
        return bytes.fromhex(exchange["read"])[skipped : skipped + read_length]

    @property
    def ran_out(self) -> bool:
        """Whether more was requested than recorded."""
        return self._recorded.ran_out

    def _covering(self, write: bytes, length: int) -> Iterator[tuple[Hashable, int]]:
        """Recorded requests whose answers contain these registers, and the offset."""
        if len(write) != 1 or not length:
            return
        for request in self._recorded.requests:
            assert isinstance(request, tuple)
            then, then_length = request
            begin = write[0] - then[0] if len(then) == 1 else -1
            if begin >= 0 and begin + length <= then_length:
                yield request, begin


class ReplayedServos:
    """A bus of servos, or another answering serial device, that repeats its recorded answers."""

    def __init__(
        self, exchanges: Sequence[tuple[Exchange, int]], say: Say, models: Mapping[int, str] | None = None
    ) -> None:
        """``models`` by id: unrecorded reads of set-up registers are answered with factory values."""
        self._say = say
        self._models = models or {}
        self._reader = RequestReader()
        asked: list[RecordedExchange[bytes]] = []
        request, answer, since = b"", b"", 0
        for exchange, epoch in [*exchanges, ({"sent": ""}, 0)]:
            if "sent" in exchange:
                if request:
                    key = _key(request)
                    asked.append(RecordedExchange(key, answer, _is_command(key), since))
                request, answer, since = bytes.fromhex(exchange["sent"]), b"", epoch
            else:
                answer += bytes.fromhex(exchange["received"])
        self._recorded = ResponseLookup(asked, self.epoch)
        self._is_dynamixel = any(isinstance(each.request, Request) for each in asked)

    def epoch(self) -> int:
        """The present epoch: number of goals given to the head."""
        at = self._recorded.at
        return 0 if at is None else at.epoch

    def answer(self, data: bytes) -> bytes:
        """The recorded answers to the requests in ``data``; none, and a call of ``say``, for an unrecorded request."""
        requests = list(self._reader.feed(data)) if self._is_dynamixel else [data]
        return b"".join(self._answer(request) for request in requests)

    @property
    def ran_out(self) -> bool:
        """Whether more was requested than recorded."""
        return self._recorded.ran_out

    def _answer(self, request: Request | bytes) -> bytes:
        answer = self._recorded.answer(self._recorded_request(request))
        if answer is None and isinstance(request, Request):
            answer = set_up_answer(request, self._models) or None
        if answer is None:
            of_pictures = (
                ": a capture looks where the pictures say, which no log holds"
                if isinstance(request, Request) and _is_goal_of(request)
                else ""
            )
            self._say(f"holds no {_described(request)}{of_pictures}")
        return answer or b""

    def _recorded_request(self, request: Request | bytes) -> Request | bytes:
        """The matching recorded request: itself, or for a goal the nearest one."""
        requests = [each for each in self._recorded.requests if isinstance(each, Request)]
        if request in requests or not isinstance(request, Request) or not _is_goal_of(request):
            return request
        goals = [each for each in requests if each.servo_id == request.servo_id and _is_goal_of(each)]
        near = [each for each in goals if abs(_tick(each) - _tick(request)) <= NEAR_TICKS]
        return min(near, key=lambda each: abs(_tick(each) - _tick(request)), default=request)


def _key(sent: bytes) -> Request | bytes:
    requests = list(RequestReader().feed(sent)) if sent.startswith(HEADER) else []
    return requests[0] if len(requests) == 1 else sent


def _is_command(request: Request | bytes) -> bool:
    return isinstance(request, bytes) or request.instruction not in (
        Instruction.PING,
        Instruction.READ,
        Instruction.SYNC_READ,
    )


def _described(request: Request | bytes) -> str:
    if isinstance(request, bytes):
        return f"request {request[:40].hex(' ')}"
    known = request.instruction in Instruction.__members__.values()
    name = Instruction(request.instruction).name if known else f"instruction {request.instruction:#04x}"
    if _is_goal_of(request):
        return f"move of servo id {request.servo_id} to tick {_tick(request)}"
    return f"{name} {request.parameters[:40].hex(' ')} to servo id {request.servo_id}"


def _is_goal_of(request: Request) -> bool:
    return (
        request.instruction == Instruction.WRITE
        and int.from_bytes(request.parameters[:2], "little") == GOAL_POSITION
    )


def _tick(goal: Request) -> int:
    return int.from_bytes(goal.parameters[2:6], "little", signed=True)


class ReplayedTalker:
    """Sends the recorded bytes with the same pauses, from the opening of the port at ``baud``.

    At the end of the bytes recorded at this stop of the head it repeats them from the first complete line. A talker
    without recorded bytes calls ``say``.
    """

    def __init__(
        self,
        port: PtyPort,
        said: Sequence[tuple[Exchange, int]],
        baud: int,
        epoch: Callable[[], int],
        say: Say,
    ) -> None:
        self._port, self._baud, self._epoch, self._say = port, baud, epoch, say
        self._said = [(float(e["t"]), bytes.fromhex(e["received"]), at) for e, at in said]
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._talk, name=f"replay {port.path}")
        self._thread.start()

    def close(self) -> None:
        """Stop sending."""
        self._stop.set()
        self._thread.join()

    def _talk(self) -> None:
        while self._port.baud != self._baud:
            if self._stop.wait(0.02):
                return
        stops = sorted({at for _, _, at in self._said})
        if not stops:
            self._say("holds nothing of this port")
            return
        while not self._stop.is_set():
            now = recorded_epoch(stops, self._epoch())
            self._say_once([(t, data) for t, data, at in self._said if at == now], now, stops)

    def _say_once(self, said: Sequence[tuple[float, bytes]], now: int, stops: Sequence[int]) -> None:
        said = whole_lines(said)
        pause_s, before_s = LISTENER_S, said[0][0]
        for at_s, data in said:
            if self._stop.wait(pause_s + at_s - before_s):
                return
            if recorded_epoch(stops, self._epoch()) != now:
                return
            self._port.send(data)
            pause_s, before_s = 0.0, at_s


def whole_lines(said: Sequence[tuple[float, bytes]]) -> list[tuple[float, bytes]]:
    """The bytes without incomplete lines at both ends.

    Unchanged if there is no complete line.
    """
    text = b"".join(data for _, data in said)
    begin = 0
    if text[0] not in FIRST_OF_A_LINE:
        begin = min((i + 1 for i in (text.find(b"\n"), text.find(b"\r")) if i >= 0), default=0)
        begin += text[begin : begin + 1] == b"\n"
    end = max(text.rfind(b"\n"), text.rfind(b"\r")) + 1
    if end <= begin:
        return list(said)
    kept, passed = [], 0
    for at_s, data in said:
        part = data[max(0, begin - passed) : max(0, end - passed)]
        if part:
            kept.append((at_s, part))
        passed += len(data)
    return kept
