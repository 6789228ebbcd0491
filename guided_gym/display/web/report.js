/* guided-gym: the page of an evaluation: tables that can be sorted, and searches that can be played. */
"use strict";
(function () {
  const G = window.GuidedGym, players = [];

  // Tables: a press on a heading sorts by it, a second one the other way round.
  for (const table of document.querySelectorAll("table.sortable")) {
    const heads = [...table.tHead.rows[0].cells], body = table.tBodies[0];
    heads.forEach((head, column) => head.querySelector("button").addEventListener("click", () => {
      const down = head.getAttribute("aria-sort") === "ascending", text = head.dataset.kind === "text";
      const value = (row) => {
        const cell = row.cells[column];
        if (text) return cell.textContent;
        return cell.dataset.value === undefined ? Infinity : Number(cell.dataset.value); // unknown ones last
      };
      const rows = [...body.rows].map((row) => [value(row), row]);
      rows.sort(([a], [b]) => {
        if (text) return (down ? -1 : 1) * a.localeCompare(b);
        return a === b ? 0 : a === Infinity ? 1 : b === Infinity ? -1 : (down ? b - a : a - b);
      });
      for (const other of heads) other.removeAttribute("aria-sort");
      head.setAttribute("aria-sort", down ? "descending" : "ascending");
      body.append(...rows.map(([, row]) => row));
    }));
  }

  // Searches, made when they are asked for.
  const made = new Map();
  function traceOf(name) {
    if (!made.has(name)) {
      const { lines, trouble } = JSON.parse(document.getElementById(name).textContent), trace = G.Trace.of(lines);
      trace.trouble = trouble || trace.trouble;
      made.set(name, trace);
    }
    return made.get(name);
  }

  document.querySelectorAll(".replays").forEach((area, number) => {
    const [left, right] = [area.querySelector(".left"), area.querySelector(".right")], place = area.querySelector(".show");
    function show() {
      const names = [left.value, ...(right.value && right.value !== left.value ? [right.value] : [])];
      const holder = G.make("div", {});
      if (players[number]) players[number].close();
      place.replaceChildren(holder);
      try {
        const traces = names.map(traceOf);
        players[number] = new G.Player(holder, traces, { stages: 460, sample: Infinity });
      } catch (error) {
        place.replaceChildren(G.make("p", { class: "notice", role: "alert", text: `This search cannot be shown: ${error.message}` }));
      }
    }
    left.addEventListener("change", show);
    right.addEventListener("change", show);
    show();
  });

  document.querySelector(".top").append(G.themeButton((theme) => players.forEach((player) => player && player.setTheme(theme))));
  window.players = players;
})();
