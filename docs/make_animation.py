"""Draw the moving picture of the README: ``python docs/make_animation.py`` (needs pygame and pillow).

A search on TrapCup by the hybrid of LazyPRM and the medial axis: first the trap, then the cup.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

from guided_gym import Search, make_distribution, make_guidance, streams
from guided_gym.envs.rendering import Renderer
from guided_gym.search.search import Expansion

FILE = Path(__file__).parent / "images" / "trapcup.gif"
SEED = 3
SIZE = 480  # pixels
EVERY = 1  # samples from a frame to the next
MILLISECONDS = 90  # of a frame
LAST = 2600  # of the last one, with the path
COLOURS = 64


class Film:
    """Keeps a frame after each sample (a watcher of `Search.run`)."""

    def __init__(self, search: Search) -> None:
        self._search, self._renderer = search, Renderer(size=SIZE)
        self.frames: list[Image.Image] = []
        self.keep()

    def keep(self) -> None:
        """Add the search as it stands."""
        self.frames.append(Image.fromarray(np.asarray(self._renderer.frame(self._search))))

    def before(self, node: int) -> None:
        """A node is chosen: nothing to see yet."""

    def after(self, expansion: Expansion) -> None:
        """A sample was drawn."""
        if self._search.samples % EVERY == 0:
            self.keep()


def main() -> None:
    """Search, and write the file."""
    _, expansion_rng, guidance_rng = streams(SEED)
    search = Search(make_distribution("TrapCup").problem(0), expansion_rng, guidance_rng)
    guidance = make_guidance("hybrid")
    search.attach(guidance)
    film = Film(search)
    search.run(guidance, 1000, propose=guidance.propose, watcher=film)
    film.keep()
    palette = film.frames[-1].quantize(
        COLOURS, dither=Image.Dither.NONE
    )  # one for all: what stays, costs nothing
    frames = [frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in film.frames]
    times = [MILLISECONDS] * (len(frames) - 1) + [LAST]
    frames[0].save(FILE, save_all=True, append_images=frames[1:], duration=times, loop=0, optimize=True)
    print(f"{FILE}: {len(frames)} frames, {FILE.stat().st_size / 1e6:.2g} MB, {search.samples} samples")


if __name__ == "__main__":
    main()
