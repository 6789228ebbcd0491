/* guided-gym: the page of a replay; its traces are in script elements with the class "trace". */
"use strict";
(function () {
  const G = window.GuidedGym, main = document.querySelector("main"), holder = document.getElementById("player");
  try {
    const traces = [...document.querySelectorAll("script.trace")].map((element) => {
      const { lines, trouble } = JSON.parse(element.textContent), trace = G.Trace.of(lines);
      trace.trouble = trouble || trace.trouble;
      return trace;
    });
    const player = new G.Player(holder, traces, { keys: true });
    document.querySelector(".top").append(G.themeButton((theme) => player.setTheme(theme)));
    window.player = player;
  } catch (error) {
    main.append(G.make("p", { class: "notice", role: "alert", text: `This replay cannot be shown: ${error.message}` }));
  }
})();
