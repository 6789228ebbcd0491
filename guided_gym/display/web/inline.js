/* guided-gym: a search played inside a notebook, light or dark as the system is. */
"use strict";
(function () {
  const G = window.GuidedGym, { lines } = JSON.parse(document.querySelector("script.trace").textContent);
  const dark = matchMedia("(prefers-color-scheme: dark)"), follow = () => (document.documentElement.dataset.theme = dark.matches ? "dark" : "light");
  follow();
  const player = new G.Player(document.getElementById("player"), [G.Trace.of(lines)], { stages: 440, sample: Infinity });
  dark.addEventListener("change", () => player.setTheme(follow()));
  window.player = player;
})();
