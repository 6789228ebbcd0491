/* guided-gym: plays searches from their traces, one or two side by side. Needs view.js.
 *
 *   const player = new GuidedGym.Player(element, [trace, ...], {keys: true, stages: 420});
 *   player.seek(100); player.play(); player.setTheme("dark"); player.grew();   // after trace.push
 */
"use strict";
(function (root) {
  const G = root.GuidedGym;
  const SPEEDS = [1, 5, 20, 60, 200, 1000]; // samples a second
  const LAYERS = [["guide", "guide's view", "g"], ["tree", "tree", "t"], ["failures", "collisions", "c"],
    ["choice", "last choice", "l"], ["path", "path found", "p"], ["regions", "regions", "r"]];
  let players = 0;

  /** An element with attributes (``text`` is its text, functions are listeners) and children. */
  function make(tag, attributes = {}, ...children) {
    const element = document.createElement(tag);
    for (const [name, value] of Object.entries(attributes)) {
      if (name === "text") element.textContent = value;
      else if (typeof value === "function") element.addEventListener(name, value);
      else if (value === true) element.setAttribute(name, "");
      else if (value !== false && value !== null) element.setAttribute(name, value);
    }
    element.append(...children);
    return element;
  }

  // Drawn, as fonts lack such signs.
  const ICONS = {
    play: "M4 2.5v11l9-5.5z", pause: "M3.5 2.5h3v11h-3z M9.5 2.5h3v11h-3z",
    start: "M3 2.5h2v11H3z M13 2.5v11L5.5 8z", end: "M11 2.5h2v11h-2z M3 2.5v11L10.500 8z",
    back: "M11 2.5v11L3.500 8z", on: "M5 2.5v11L12.500 8z",
    in: "M7 3h2v4h4v2H9v4H7V9H3V7h4z", out: "M3 7h10v2H3z",
    fit: "M2 2h4v2H4v2H2z M10 2h4v4h-2V4h-2z M2 10h2v2h2v2H2z M12 10h2v4h-4v-2h2z",
    light: "M8 5a3 3 0 1 0 .01 0z M7.200 1h1.600v2.500H7.200z M7.200 12.500h1.600V15H7.200z M1 7.200h2.500v1.600H1z M12.500 7.200H15v1.600h-2.500z",
    dark: "M13.500 9.800A6 6 0 0 1 6.200 2.500 6 6 0 1 0 13.500 9.800z",
  };

  function icon(name) {
    const svg = document.createElementNS("http://www.w3.org/2000/svg", "svg");
    for (const [key, value] of [["viewBox", "0 0 16 16"], ["width", "16"], ["height", "16"], ["aria-hidden", "true"]]) svg.setAttribute(key, value);
    const path = document.createElementNS("http://www.w3.org/2000/svg", "path");
    path.setAttribute("d", ICONS[name]);
    path.setAttribute("fill", "currentColor");
    svg.append(path);
    return svg;
  }

  const digits = (value, count = 3) => (Number.isFinite(value) ? String(Number(value.toPrecision(count))) : "–");

  class Player {
    constructor(element, traces, { keys = false, theme = null, stages = null, sample = 0, chart = true } = {}) {
      this.element = element;
      this.traces = traces;
      this.id = `player${++players}`;
      this.sample = 0;
      this.playing = false;
      this.speed = 60;
      this.fixedTheme = theme;
      element.classList.add("player");
      element.classList.toggle("single", traces.length === 1);
      element.replaceChildren();
      this._panels(stages);
      if (chart) this._chart();
      this._bar();
      this._layerBoxes();
      this._legend();
      this._help();
      this._listener = (event) => this._key(event);
      (keys ? document : element).addEventListener("keydown", this._listener);
      this._resized = new ResizeObserver(() => this._resize());
      this._resized.observe(element);
      this.setTheme(theme || pageTheme());
      this._setLength();
      this.seek(sample);
    }

    get length() { return Math.max(0, ...this.traces.map((trace) => trace.samples)); }

    // Parts -----------------------------------------------------------------------------------------------

    _panels(height) {
      const row = make("div", { class: "panels" });
      this.stages = []; this.readouts = []; this.captions = [];
      this.traces.forEach((trace, i) => {
        const canvas = make("canvas", { class: "stage", role: "img", tabindex: 0 });
        const [xmin, ymin, xmax, ymax] = trace.scene.bounds, shape = (xmax - xmin) / (ymax - ymin);
        canvas.style.aspectRatio = String(Math.min(3, Math.max(0.7, shape)));
        const most = height ? `${height}px` : "min(78vh, 900px)"; // high; and no wider than that needs
        canvas.style.maxWidth = `calc(${most} * ${Math.min(3, Math.max(0.7, shape))})`;
        const stage = new G.Stage(canvas), readout = make("p", { class: "readout" });
        stage.setTrace(trace, 0);
        stage.onview = (view) => this._sameView(stage, view);
        stage.onhover = () => this._read(i);
        const { guidance, title } = trace.header, said = make("span", { class: "muted", text: captionOf(trace) });
        const caption = make("figcaption", {}, make("strong", { text: title || guidance || "search" }), said);
        this.captions.push(said);
        const figure = make("figure", {}, caption);
        if (trace.trouble) figure.append(make("p", { class: "notice", role: "status", text: `This trace ends early: ${trace.trouble}.` }));
        for (const text of trace.header.notices || []) figure.append(make("p", { class: "notice", role: "status", text }));
        figure.append(canvas, readout);
        row.append(figure);
        this.stages.push(stage); this.readouts.push(readout);
      });
      this.element.append(row);
    }

    _chart() {
      if (!this.traces.some((trace) => trace.se.some(Number.isFinite)) && this.traces.every((trace) => trace.end)) return;
      const canvas = make("canvas", { class: "curve", role: "img",
        "aria-label": "Sampling efficiency of each sample in nats, lower is better; point at a sample to go there" });
      this.curve = new G.Curve(canvas, this.traces);
      this.curve.onseek = (sample) => { this.pause(); this.seek(sample); };
      this.element.append(make("div", {}, make("div", { class: "muted", text: "SE of each choice (nats, lower is better)" }), canvas));
    }

    _bar() {
      const button = (sign, label, action, extra = {}) =>
        make("button", { type: "button", "aria-label": label, title: label, click: action, ...extra }, icon(sign));
      this.playButton = button("play", "Play", () => this.toggle(), { class: "main" });
      this.scrub = make("input", { type: "range", class: "scrub", min: 0, max: 1, value: 0, "aria-label": "Sample",
        input: () => { this.pause(); this.seek(Number(this.scrub.value)); } });
      this.count = make("span", { class: "count muted" });
      this.speedSelect = make("select", { "aria-label": "Speed", title: "Speed",
        change: () => { this.speed = Number(this.speedSelect.value); } },
      ...SPEEDS.map((s) => make("option", { value: s, text: `${s}/s`, selected: s === this.speed })));
      this.element.append(make("div", { class: "bar", role: "group", "aria-label": "Playback" },
        this.playButton,
        button("start", "To the start", () => { this.pause(); this.seek(0); }),
        button("back", "One sample back", () => { this.pause(); this.seek(this.sample - 1); }),
        button("on", "One sample on", () => { this.pause(); this.seek(this.sample + 1); }),
        button("end", "To the end", () => { this.pause(); this.seek(this.length); }),
        this.scrub, this.count, this.speedSelect,
        button("in", "Zoom in", () => this.zoom(1.4)), button("out", "Zoom out", () => this.zoom(1 / 1.4)),
        button("fit", "Show the whole workspace", () => this.fit())));
    }

    _layerBoxes() {
      const set = make("fieldset", {}, make("legend", { text: "Show" }));
      this.boxes = {};
      for (const [layer, text] of LAYERS) {
        if (layer === "regions" && !this.traces.some((trace) => trace.scene.regions.length)) continue;
        if (layer === "guide" && !this.traces.some((trace) => trace.views.some((v) => v.length)) && this.traces.every((trace) => trace.end)) continue;
        const box = make("input", { type: "checkbox", change: () => this.show(layer, box.checked) });
        box.checked = this.stages[0].layers[layer];
        this.boxes[layer] = box;
        set.append(make("label", {}, box, text));
      }
      const most = this.traces.reduce((a, b) => (b.views.length > a.views.length ? b : a));
      if (most.views.length > 1) {
        const select = make("select", { "aria-label": "Whose view", title: "Whose view",
          change: () => { for (const stage of this.stages) stage.guide = Number(select.value); this.draw(); } },
        make("option", { value: -1, text: "who guides" }),
        ...most.header.guides.map((name, i) => make("option", { value: i, text: name })));
        set.append(select);
      }
      this.element.append(set);
    }

    _legend() {
      this.legend = make("div", { class: "legend" });
      this.element.append(this.legend);
    }

    _drawLegend() {
      const colours = G.THEMES[this.theme], swatch = (style, text) => {
        const mark = make("i", {});
        Object.assign(mark.style, style);
        return make("span", { class: "key" }, mark, text);
      };
      const items = [swatch({ background: colours.start }, "start"), swatch({ background: colours.goal }, "goal")];
      if (this.traces.some((trace) => trace.measured)) {
        const scale = make("i", { class: "scale" });
        scale.style.background = `linear-gradient(90deg, ${colours.levels.join()})`;
        items.push(make("span", { class: "key" }, "little Q", scale, "much Q"));
      }
      items.push(swatch({ background: colours.failure, opacity: 0.5, width: "9px", height: "9px", borderRadius: "0" }, "collision"),
        swatch({ background: colours.path, opacity: 0.5 }, "path found"));
      const kinds = this._kinds = this._kindsOfViews();
      if (kinds.has("graph")) {
        items.push(swatch({ background: colours.graph, height: "3px" }, "guide's graph"));
        if (kinds.has("weights")) items.push(swatch({ background: colours.failure, height: "2px", opacity: 0.6 }, "removed by failures"),
          swatch({ background: `linear-gradient(90deg, ${colours.heavy.join()})`, height: "4px" }, "made longer"));
      }
      if (kinds.has("field")) items.push(swatch({ background: `linear-gradient(90deg, rgba(${colours.field},.65), rgba(${colours.field},.05))` }, "guide's h, low to high"));
      if (kinds.has("cells")) items.push(swatch({ background: `rgba(${colours.field},.4)` }, "cells, the stronger the larger"));
      if (this.traces.length > 1) this.traces.forEach((trace, i) =>
        items.push(swatch({ background: colours.series[i], height: "4px" }, `SE: ${trace.header.title || trace.header.guidance}`)));
      if (this.curve) items.push(swatch({ borderTop: `2px dotted ${colours.muted}`, height: 0 }, "best possible"));
      this.legend.replaceChildren(...items);
    }

    _kindsOfViews() { return new Set(this.traces.flatMap((trace) => trace.views.flatMap((events) => events.map((one) => one.kind)))); }

    _help() {
      const keys = [["Space", "play or pause"], ["← →", "a sample back or on; with Shift, ten"], ["Home End", "start, end"],
        ["+ − 0", "zoom in, out, fit"], ["G T C L P R", "layers"], ["< >", "slower, faster"]];
      this.element.append(make("details", { class: "help" }, make("summary", { text: "Keys and gestures" }),
        make("ul", {}, ...keys.map(([key, text]) => make("li", {}, make("kbd", { text: key }), ` ${text}`)),
          make("li", { text: "Drag to move; wheel or two fingers to zoom; point at a node for its Q and its way." }))));
    }

    // What it does ----------------------------------------------------------------------------------------

    seek(sample) {
      this.sample = Math.max(0, Math.min(this.length, Math.round(sample)));
      this.scrub.value = String(this.sample);
      this.count.textContent = `${this.sample} / ${this.length}`;
      this.stages.forEach((stage, i) => { stage.sample = Math.min(this.sample, this.traces[i].samples); });
      this.draw();
    }

    draw() {
      this.stages.forEach((stage, i) => { stage.draw(); this._read(i); });
      if (this.curve) { this.curve.sample = this.sample; this.curve.draw(); }
    }

    /** Stop, and let go of the page. */
    close() {
      this.pause();
      this._resized.disconnect();
      document.removeEventListener("keydown", this._listener);
    }

    play() {
      if (this.playing || !this.length) return;
      if (this.sample >= this.length) this.seek(0);
      this.playing = true;
      this._playLabel();
      let last = performance.now(), due = 0;
      const tick = (now) => {
        if (!this.playing) return;
        due += Math.min(0.25, Math.max(0, now - last) / 1000) * this.speed; last = now;
        if (due >= 1) { this.seek(this.sample + Math.floor(due)); due -= Math.floor(due); }
        if (this.sample >= this.length) return this.pause();
        requestAnimationFrame(tick);
      };
      requestAnimationFrame(tick);
    }

    pause() {
      if (!this.playing) return;
      this.playing = false;
      this._playLabel();
      this.draw(); // labels for those who cannot see
    }

    toggle() { if (this.playing) this.pause(); else this.play(); }

    _playLabel() {
      this.playButton.replaceChildren(icon(this.playing ? "pause" : "play"));
      this.playButton.setAttribute("aria-label", this.playing ? "Pause" : "Play");
      this.playButton.title = this.playing ? "Pause" : "Play";
    }

    show(layer, on) {
      for (const stage of this.stages) stage.layers[layer] = on;
      if (this.boxes[layer]) this.boxes[layer].checked = on;
      this.draw();
    }

    zoom(factor) { this.stages[0].zoom(factor); }
    fit() { for (const stage of this.stages) stage.fit(); }

    setTheme(theme) {
      this.theme = theme;
      for (const stage of this.stages) stage.theme = theme;
      if (this.curve) this.curve.theme = theme;
      this._drawLegend();
      this.draw();
    }

    /** After `push` on a trace: show its newest sample if the last one was shown. */
    grew() {
      const follow = this.sample >= Number(this.scrub.max);
      this._setLength();
      if (this._kindsOfViews().size !== this._kinds.size) this._drawLegend();
      this.captions.forEach((said, i) => { said.textContent = captionOf(this.traces[i]); });
      this.seek(follow ? this.length : this.sample);
    }

    _setLength() { this.scrub.max = String(this.length); }

    /** What is at one place in one panel is at the same place in the other, if it is the same workspace. */
    _sameView(stage, view) {
      for (const other of this.stages) {
        if (other === stage || JSON.stringify(other.scene.bounds) !== JSON.stringify(stage.scene.bounds)) continue;
        other.view = view;
        other.draw();
      }
    }

    _resize() {
      cancelAnimationFrame(this._frame);
      this._frame = requestAnimationFrame(() => this.draw());
    }

    _read(i) {
      const trace = this.traces[i], stage = this.stages[i], k = stage.sample - 1, parts = [];
      const say = (name, value, after = "") => parts.push(make("span", { class: "fact" }, `${name} `, make("b", { text: value }), after));
      if (stage.hover >= 0 && stage.hover < trace.sizes[stage.sample]) {
        const v = stage.hover;
        say("node", v); say("Q", digits(trace.probability(v)));
        say("way from the start", digits(trace.cost[v])); say("to the goal", digits(trace.tau[v]));
      } else if (k < 0) parts.push("No sample drawn yet.");
      else {
        const name = trace.header.guides && trace.header.guides.length > 1 && Number.isFinite(trace.guide[k]) ? trace.header.guides[trace.guide[k]] : "";
        const became = trace.child[k] < 0 ? "collision" : `node ${trace.child[k]}${trace.reached[k] ? ", which reaches the goal" : ""}`;
        say(name ? `${name} chose node` : "chosen: node", trace.node[k], ` → ${became}`);
        if (Number.isFinite(trace.se[k])) say("SE", digits(trace.se[k]));
        if (Number.isFinite(trace.best[k])) say("best possible", digits(trace.best[k]));
        if (Number.isFinite(trace.h[k])) say("h", digits(trace.h[k]));
      }
      const size = `${trace.sizes[stage.sample]} nodes, ${trace.failures[stage.sample]} collisions`;
      this.readouts[i].replaceChildren(...parts.flatMap((part) => [part, " "]), make("span", { class: "fact", text: size }));
      if (!this.playing) {
        stage.canvas.setAttribute("aria-label",
          `${trace.header.guidance || "Search"} on ${trace.scene.name} after ${stage.sample} of ${trace.samples} samples: ${size}. ${this.readouts[i].textContent}`);
      }
    }

    _key(event) {
      if (event.ctrlKey || event.metaKey || event.altKey) return;
      const tag = event.target.tagName, key = event.key;
      if (tag === "SELECT" || (tag === "INPUT" && event.target.type !== "range" && event.target.type !== "checkbox")) return;
      if (key === " " && ["BUTTON", "SUMMARY", "INPUT"].includes(tag) && event.target !== this.scrub) return;
      const step = event.shiftKey ? 10 : 1, layer = LAYERS.find(([, , letter]) => letter === key.toLowerCase());
      const act = {
        " ": () => this.toggle(),
        ArrowLeft: () => { this.pause(); this.seek(this.sample - step); },
        ArrowRight: () => { this.pause(); this.seek(this.sample + step); },
        Home: () => { this.pause(); this.seek(0); },
        End: () => { this.pause(); this.seek(this.length); },
        "+": () => this.zoom(1.4), "=": () => this.zoom(1.4), "-": () => this.zoom(1 / 1.4), 0: () => this.fit(),
        "<": () => this._faster(-1), ">": () => this._faster(1),
      }[key] || (layer && this.boxes[layer[0]] && (() => this.show(layer[0], !this.stages[0].layers[layer[0]])));
      if (!act) return;
      event.preventDefault();
      act();
    }

    _faster(by) {
      const i = Math.max(0, Math.min(SPEEDS.length - 1, SPEEDS.indexOf(this.speed) + by));
      this.speed = SPEEDS[i];
      this.speedSelect.value = String(this.speed);
    }
  }

  function captionOf(trace) {
    const { seed } = trace.header;
    return [trace.scene.name, seed === null || seed === undefined ? "" : `seed ${seed}`, outcome(trace)].filter(Boolean).join(" · ");
  }

  function outcome(trace) {
    if (!trace.end) return `${trace.samples} samples`;
    const samples = `${trace.samples} ${trace.samples === 1 ? "sample" : "samples"}`;
    return trace.end.solved ? `solved after ${samples}` : `not solved in ${samples}`;
  }

  // The page ----------------------------------------------------------------------------------------------

  /** "light" or "dark": what the page's reader chose, else what the system wishes. */
  function pageTheme() {
    const chosen = document.documentElement.dataset.theme;
    return chosen || (matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light");
  }

  /** Light or dark for the whole page; `listener(theme)` hears of changes. Returns the button that toggles. */
  function themeButton(listener) {
    const button = make("button", { type: "button", click: () => apply(pageTheme() === "dark" ? "light" : "dark") });
    function apply(theme) {
      document.documentElement.dataset.theme = theme;
      const other = theme === "dark" ? "light" : "dark";
      button.replaceChildren(icon(theme === "dark" ? "light" : "dark"));
      button.setAttribute("aria-label", `Change to ${other}`);
      button.title = `Change to ${other}`;
      listener(theme);
    }
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", (event) => apply(event.matches ? "dark" : "light"));
    apply(pageTheme());
    return button;
  }

  Object.assign(G, { Player, make, pageTheme, themeButton, digits });
})(typeof globalThis !== "undefined" ? globalThis : window);
