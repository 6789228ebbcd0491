"""A learned agent that has learned nothing: known answers, no training."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pytest

from guided_gym.guidance.learned import field as fields
from guided_gym.guidance.learned import scorer as scorers
from guided_gym.guidance.learned import weights
from guided_gym.guidance.learned.field import FieldArchitecture
from guided_gym.guidance.learned.scorer import ScorerArchitecture

ARCHITECTURE = FieldArchitecture(cells=24, headings=8)


@pytest.fixture
def agent_folder(tmp_path: Path) -> Path:
    folder = tmp_path / "plain"
    tensors = {f"field.{name}": t for name, t in fields.plain_tensors(ARCHITECTURE).items()}
    scorer = ScorerArchitecture()
    tensors.update({f"scorer.{name}": t for name, t in scorers.plain_tensors(scorer).items()})
    card = {
        "name": "plain",
        "package_version": "0",
        "field": asdict(ARCHITECTURE),
        "scorer": asdict(scorer),
        "training": {},
        "metrics": {},
    }
    weights.save_agent(folder, card, tensors)
    return folder


@pytest.fixture(scope="session")
def serve_lab() -> Callable[..., AbstractContextManager[Any]]:
    """Serves a lab of a folder while a block runs, and gives its port and the lab."""
    pytest.importorskip("starlette", reason="the extra [lab] is not installed")
    uvicorn = pytest.importorskip("uvicorn", reason="the extra [lab] is not installed")
    from guided_gym.train.lab.server import Lab, bound_socket

    @contextlib.contextmanager
    def served(folder: Path, *args: Any) -> Iterator[tuple[int, Lab]]:
        lab, taken = Lab(folder, *args), bound_socket(0)
        port = taken.getsockname()[1]
        config = uvicorn.Config(lab.application(port), log_level="error", timeout_graceful_shutdown=1)
        server = uvicorn.Server(config)
        thread = threading.Thread(target=server.run, kwargs={"sockets": [taken]}, daemon=True)
        thread.start()
        while not server.started and thread.is_alive():
            time.sleep(0.01)
        yield port, lab
        server.should_exit = True
        thread.join(20)
        assert not thread.is_alive()

    return served
