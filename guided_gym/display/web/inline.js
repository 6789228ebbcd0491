/* guided-gym: a search played inside a notebook. */
"use strict";
(function () {
  const G = window.GuidedGym, { lines } = JSON.parse(document.querySelector("script.trace").textContent);
  const player = new G.Player(document.getElementById("player"), [G.Trace.of(lines)], { stages: 440, sample: Infinity });
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => player.setTheme(G.pageTheme()));
  window.player = player;
})();
