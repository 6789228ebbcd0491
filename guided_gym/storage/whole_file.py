"""Files that are there whole or not at all, whenever the process is killed."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

from guided_gym.errors import StorageError


def write_whole(file: Path, content: bytes | str) -> None:
    """Write a file whole or not at all; make its folder. Text is written as UTF-8.

    Raises:
        StorageError: The place cannot be written, or the text is none that UTF-8 has.
    """
    try:
        data = content.encode("utf-8") if isinstance(content, str) else content
        file.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(dir=file.parent, prefix=f".{file.name}.")
        try:
            with os.fdopen(handle, "wb") as stream:
                stream.write(data)
                stream.flush()
                os.fsync(stream.fileno())
            os.chmod(name, 0o644)
            os.replace(name, file)
        except BaseException:
            Path(name).unlink(missing_ok=True)
            raise
    except (OSError, UnicodeEncodeError) as error:
        raise StorageError(f"cannot write {file}: {error}") from error
