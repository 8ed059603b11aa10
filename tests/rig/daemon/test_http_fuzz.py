"""The server asked everything that its own OpenAPI document allows, and much that it does not; a few examples of each."""

from collections.abc import Iterator
from pathlib import Path

import pytest
import schemathesis
from fakes.located import ScriptedActions, answer_of, bundle_id, write_bundle
from hypothesis import HealthCheck, given, settings, strategies
from schemathesis import GenerationMode

from localizer.track.tracker import Tracker
from rig.config.run import HttpServer
from rig.daemon.http import serving
from rig.daemon.spool.store import Spool
from rig.daemon.state import DaemonState

SANTA_CRUZ = Path(__file__).parents[3] / "sim" / "terrain" / "santa_cruz_srtm_1s.tif"
TOKEN = "0123456789abcdef0123456789abcdef"


@pytest.fixture(scope="module")
def api(tmp_path_factory: pytest.TempPathFactory) -> Iterator[schemathesis.BaseSchema]:
    """The real application on a real socket, over a spool with two bundles."""
    folder = tmp_path_factory.mktemp("fuzz")
    token = folder / "token"
    token.write_text(TOKEN)
    token.chmod(0o600)
    daemon_state = DaemonState()
    with Spool(folder / "spool", 100) as spool:
        for number in (1, 2):
            answer = answer_of(bundle_id(number))
            write_bundle(spool.bundles_dir, answer.bundle)
            spool.reconcile()
            spool.set_answer(answer, Tracker())
            daemon_state.set_answer(answer)
        section = HttpServer(listen="127.0.0.1:0", token_file=token)
        with serving(section, daemon_state, ScriptedActions(), spool, [SANTA_CRUZ]) as url:
            yield schemathesis.openapi.from_url(f"{url}/openapi.json")


LEFT_OUT = {"/events", "/map", "/map/relief.webp"}
"""A stream without an end, and what takes no parameters but a long time: see test_http_server."""


def test_every_answer_is_one_that_the_document_announces(api: schemathesis.BaseSchema) -> None:
    operations = [found.ok() for found in api.get_all_operations()]
    asked = [operation for operation in operations if operation.path not in LEFT_OUT]
    assert len(asked) == 11
    for operation in asked:

        @settings(max_examples=10, suppress_health_check=list(HealthCheck))
        @given(
            case=strategies.one_of(*(operation.as_strategy(generation_mode=mode) for mode in GenerationMode))
        )
        def send_request(case: schemathesis.Case) -> None:
            case.call_and_validate(headers={"Authorization": f"Bearer {TOKEN}"})

        send_request()
