/* guided-gym: draws motion planning problems, and searches from their traces, on a canvas.
 *
 * Depends on nothing. The format of a trace is described in docs/replay.md, that of a scene in scene.py.
 *
 *   const trace = GuidedGym.Trace.of(lines);           // header first; or new Trace(header), then push(line)
 *   const stage = new GuidedGym.Stage(canvas, {theme: "light"});
 *   stage.setScene(scene);                             // a problem alone
 *   stage.setTrace(trace); stage.sample = 10;          // a search after its tenth sample
 *   stage.draw();
 *   new GuidedGym.Curve(canvas, [trace], {theme: "light"});   // SE over samples
 */
"use strict";
(function (root) {
  const FORMAT = "guided-gym trace 1";
  const LEVELS = 24; // colours of Q
  const FLOOR = Math.log(1e4); // nats below the best node at which colours end
  const TURN = 2 * Math.PI;

  // Viridis, and colours of Okabe and Ito: told apart by the colour-blind, too.
  const THEMES = {
    light: {
      paper: "#ffffff", free: "#f8f7f4", obstacle: "#4a525e", ink: "#21252b", muted: "#747b85",
      start: "#0072b2", goal: "#008a64", path: "#d52c14", failure: "#d52c14", halo: "#f8f7f4",
      region: "#cc79a7", graph: "#0072b2", field: [0, 114, 178], heavy: ["#e69f00", "#d55e00", "#8a2f00"],
      target: [[187, 223, 39], [137, 213, 72], [83, 197, 104], [42, 176, 127], [32, 146, 140], [42, 117, 142],
        [56, 86, 140], [70, 48, 126], [68, 1, 84]],
      series: ["#0072b2", "#d55e00"], grid: "#e3e3df",
    },
    dark: {
      paper: "#14171c", free: "#1d2127", obstacle: "#77818f", ink: "#e9ebee", muted: "#98a1ad",
      start: "#56b4e9", goal: "#2fd3a2", path: "#ff8468", failure: "#ff8468", halo: "#1d2127",
      region: "#cc79a7", graph: "#56b4e9", field: [86, 180, 233], heavy: ["#f0c04a", "#ff9a4a", "#ff6a3d"],
      target: [[88, 76, 150], [76, 100, 168], [62, 126, 170], [48, 150, 166], [42, 176, 150], [74, 200, 120],
        [137, 217, 80], [196, 228, 50], [253, 240, 90]],
      series: ["#56b4e9", "#ff9a4a"], grid: "#2c323b",
    },
  };

  function shades(stops, count) {
    return Array.from({ length: count }, (_, i) => {
      const at = (i / (count - 1)) * (stops.length - 1), low = Math.min(Math.floor(at), stops.length - 2);
      const mixed = stops[low].map((v, c) => Math.round(v + (at - low) * (stops[low + 1][c] - v)));
      return `rgb(${mixed})`;
    });
  }
  for (const theme of Object.values(THEMES)) theme.levels = shades(theme.target, LEVELS);

  // Robots ----------------------------------------------------------------------------------------------

  /** Places a robot's bodies: a table of joints, each moved by one coordinate, and bodies on them. */
  class Kinematics {
    constructor(robot) {
      this.joints = robot.joints;
      this.bodies = robot.bodies;
      this.tipJoint = robot.tip.joint;
      this.tipPoint = robot.tip.point;
      this.frames = new Float64Array(4 * (this.joints.length + 1)); // x, y, cos, sin; the world's first
      this.frames[2] = 1;
    }

    _place(q) {
      const f = this.frames;
      this.joints.forEach((joint, i) => {
        const p = 4 * (joint.parent + 1), o = 4 * (i + 1), c = f[p + 2], s = f[p + 3];
        const value = joint.coordinate < 0 ? joint.value || 0 : q[joint.coordinate];
        let [x, y] = joint.offset;
        if (joint.kind === "x") x += value;
        else if (joint.kind === "y") y += value;
        f[o] = f[p] + c * x - s * y;
        f[o + 1] = f[p + 1] + s * x + c * y;
        if (joint.kind === "turn") {
          const ct = Math.cos(value), st = Math.sin(value);
          f[o + 2] = c * ct - s * st;
          f[o + 3] = s * ct + c * st;
        } else { f[o + 2] = c; f[o + 3] = s; }
      });
    }

    _at(joint, points) {
      const o = 4 * (joint + 1), [x, y, c, s] = this.frames.subarray(o, o + 4);
      const out = new Float64Array(points.length);
      for (let i = 0; i < points.length; i += 2) {
        out[i] = x + c * points[i] - s * points[i + 1];
        out[i + 1] = y + s * points[i] + c * points[i + 1];
      }
      return out;
    }

    /** [{points: flat x, y, ..., closed}] of a configuration: what the robot covers of the workspace. */
    place(q) {
      this._place(q);
      return this.bodies.map((b) => ({ points: this._at(b.joint, b.ring), closed: b.closed }));
    }

    /** [x, y] where a configuration is drawn as a point. */
    tip(q) {
      this._place(q);
      return this._at(this.tipJoint, this.tipPoint);
    }
  }

  /** The same for an arm in space, seen from one side: a chain of joints that spin about z or slide along it. */
  class SpatialKinematics {
    constructor(robot) {
      Object.assign(this, { view: robot.view, joints: robot.joints, bodies: robot.bodies, tipAt: robot.tip });
      this.frames = this.joints.map(() => ({ r: new Float64Array(9), p: new Float64Array(3) }));
      this.world = { r: [1, 0, 0, 0, 1, 0, 0, 0, 1], p: [0, 0, 0] };
    }

    _place(q) {
      let before = this.world;
      this.joints.forEach((joint, i) => {
        const { r, p } = this.frames[i], t = joint.turned, value = joint.factor * q[joint.coordinate] + joint.shift;
        const slide = joint.kind === "slide" ? value : 0, c = slide ? 1 : Math.cos(joint.kind === "slide" ? 0 : value);
        const s = joint.kind === "slide" ? 0 : Math.sin(value), o = joint.offset.map((v, k) => v + slide * t[3 * k + 2]);
        for (let k = 0; k < 3; k += 1) {
          const a = before.r.slice(3 * k, 3 * k + 3), row = [0, 1, 2].map((m) => a[0] * t[m] + a[1] * t[m + 3] + a[2] * t[m + 6]);
          p[k] = before.p[k] + a[0] * o[0] + a[1] * o[1] + a[2] * o[2];
          r[3 * k] = c * row[0] + s * row[1]; r[3 * k + 1] = c * row[1] - s * row[0]; r[3 * k + 2] = row[2];
        }
        before = this.frames[i];
      });
    }

    _seen(joint, point) {
      const { r, p } = joint < 0 ? this.world : this.frames[joint], v = this.view;
      const at = [0, 1, 2].map((k) => p[k] + r[3 * k] * point[0] + r[3 * k + 1] * point[1] + r[3 * k + 2] * point[2]);
      return [v[0] * at[0] + v[1] * at[1] + v[2] * at[2], v[3] * at[0] + v[4] * at[1] + v[5] * at[2]];
    }

    place(q) {
      this._place(q);
      return this.bodies.map(({ joint, start, end, radius }) => {
        const a = this._seen(joint, start), b = this._seen(joint, end), heading = Math.atan2(b[1] - a[1], b[0] - a[0]);
        const points = new Float64Array(52);
        for (let k = 0; k < 26; k += 1) { // half a circle around each end
          const [x, y] = k < 13 ? b : a, turn = heading - Math.PI / 2 + Math.PI * (k < 13 ? k / 12 : (k - 1) / 12);
          points[2 * k] = x + radius * Math.cos(turn); points[2 * k + 1] = y + radius * Math.sin(turn);
        }
        return { points, closed: true };
      });
    }

    tip(q) {
      this._place(q);
      return this._seen(this.tipAt.joint, this.tipAt.point);
    }
  }

  const kinematicsOf = (robot) => (robot.view ? new SpatialKinematics(robot) : new Kinematics(robot));

  // Traces ----------------------------------------------------------------------------------------------

  /** A search, grown line by line; `seek(k)` makes parents and costs those after k samples. */
  class Trace {
    constructor(header) {
      if (!header || header.format !== FORMAT) {
        throw new Error(`expected ${FORMAT}, got ${header && header.format ? header.format : "no trace"}`);
      }
      if (!header.scene) throw new Error("expected a scene beside the problem, got none");
      this.header = header;
      this.scene = header.scene;
      this.kinematics = kinematicsOf(this.scene.robot);
      this.d = this.scene.start.length;
      this.weights = this.scene.metric.weights;
      this.periods = this.scene.metric.periods;
      this.samples = 0;
      this.end = null;
      // Of each sample.
      this.node = []; this.child = []; this.guide = []; this.h = []; this.se = []; this.best = [];
      this.reached = []; this.failure = []; this.sizes = [1]; // nodes after so many samples
      // Of each node.
      this.q = [...this.scene.start]; this.x = []; this.y = []; this.parent = [-1]; this.cost = [0];
      this.tau = [header.work ?? NaN]; this.born = [0];
      this._point(this.scene.start, this.x, this.y);
      // Of each failure.
      this.failed = []; this.target = []; this.contact = []; this.fx = []; this.fy = [];
      this.failures = [0]; // after so many samples
      this.rewirings = []; // {at, node, parent, old}
      this.views = (header.guides || []).map(() => []); // of each guide: {at, kind, ...}
      this.at = 0; this._applied = 0; this._states = [];
      this.version = 0; // of parents, costs and with them energies
      this.energy = []; this._lowest = [];
      this._measured = Number.isFinite(header.work) && !!header.target;
      this._static = this._measured && header.target.normalisation !== "tree" && !header.rewire && !header.watched;
      if (this._static) this._addEnergy(0);
    }

    /** A trace of lines (texts or parsed), as far as they can be read; `trouble` says where that ends. */
    static of(lines) {
      const parse = (line) => (typeof line === "string" ? JSON.parse(line) : line);
      const trace = new Trace(parse(lines[0]));
      for (let i = 1; i < lines.length; i++) {
        try { trace.push(parse(lines[i])); } catch (error) {
          trace.trouble = `line ${i + 1} cannot be read: ${error.message}`;
          break;
        }
      }
      return trace;
    }

    get nodes() { return this.cost.length; }
    get measured() { return this._measured; }
    get solved() { return !!(this.end && this.end.solved); }

    /** Take in one more line; a text or what was parsed of it. */
    push(line) {
      const row = typeof line === "string" ? JSON.parse(line) : line;
      if (row.view !== undefined) return this._pushView(row);
      if (row.end !== undefined) { this.end = row.end; return; }
      if (row.also !== undefined) return this._gain(row);
      if (!(row.n >= 0 && row.n < this.nodes)) throw new Error(`no node ${row.n}`);
      this._toEnd();
      const target = row.x;
      if (!Array.isArray(target) || target.length !== this.d) throw new Error("no configuration");
      this.node.push(row.n);
      for (const [list, value] of [[this.guide, row.g], [this.h, row.h], [this.se, row.s], [this.best, row.b]]) {
        list.push(value ?? NaN);
      }
      this.reached.push(!!row.r);
      if (row.c) {
        this.child.push(-1);
        this.failure.push(this.failed.length);
        this.failed.push(row.n);
        this.target.push(...target); this.contact.push(...row.c);
        this._point(row.c, this.fx, this.fy);
      } else {
        this.child.push(this.nodes);
        this.failure.push(-1);
        this._grow(row, target, this.samples + 1);
      }
      this.samples += 1;
      if (row.w) for (const [node, parent] of row.w) this._rewire(node, parent);
      this.sizes.push(this.nodes);
      this.failures.push(this.failed.length);
      this.at = this.samples;
      if (row.w) this._recost();
    }

    /** What the tree of a watched planner gained without a sample: shown with the sample before. */
    _gain(row) {
      this._toEnd();
      for (const node of row.also) {
        if (!(node.n >= 0 && node.n < this.nodes)) throw new Error(`no node ${node.n}`);
        if (!Array.isArray(node.x) || node.x.length !== this.d) throw new Error("no configuration");
        this._grow(node, node.x, this.samples);
      }
      for (const [node, parent] of row.w || []) this._rewire(node, parent);
      this.sizes[this.samples] = this.nodes;
      if (row.w) this._recost(); else this.version += 1;
    }

    _grow(row, target, born) {
      const child = this.nodes;
      this.q.push(...target);
      this._point(target, this.x, this.y);
      this.parent.push(row.n);
      this.cost.push(this.cost[row.n] + this.distance(row.n, child));
      this.tau.push(row.t ?? NaN);
      this.born.push(born);
      if (this._static) this._addEnergy(child);
    }

    _rewire(node, parent) {
      this.rewirings.push({ at: this.samples, node, parent, old: this.parent[node] });
      this.parent[node] = parent;
      this._applied = this.rewirings.length;
    }

    _point(q, xs, ys) {
      const [x, y] = this.kinematics.tip(q);
      xs.push(x); ys.push(y);
    }

    configuration(node) { return this.q.slice(node * this.d, (node + 1) * this.d); }

    /** The configuration that the given sample (from 0) aimed at, and where it collided, if it did. */
    attempt(sample) {
      const child = this.child[sample], f = this.failure[sample], d = this.d;
      if (child >= 0) return { target: this.configuration(child), contact: null };
      return { target: this.target.slice(f * d, f * d + d), contact: this.contact.slice(f * d, f * d + d) };
    }

    difference(a, b) { // configurations as arrays
      return a.map((v, i) => {
        const change = b[i] - v, period = this.periods[i];
        return period ? change - period * Math.round(change / period) : change;
      });
    }

    distance(a, b) { // nodes
      let sum = 0;
      for (let i = 0; i < this.d; i++) {
        let change = this.q[b * this.d + i] - this.q[a * this.d + i];
        const period = this.periods[i];
        if (period) change -= period * Math.round(change / period);
        sum += (change * this.weights[i]) ** 2;
      }
      return Math.sqrt(sum);
    }

    _toEnd() { if (this.at !== this.samples) this.seek(this.samples); }

    /** Have parents, costs and energies those after k samples. */
    seek(k) {
      k = Math.max(0, Math.min(this.samples, Math.round(k)));
      const r = this.rewirings, before = this._applied;
      while (this._applied < r.length && r[this._applied].at <= k) {
        this.parent[r[this._applied].node] = r[this._applied].parent;
        this._applied += 1;
      }
      while (this._applied > 0 && r[this._applied - 1].at > k) {
        this._applied -= 1;
        this.parent[r[this._applied].node] = r[this._applied].old;
      }
      this.at = k;
      if (this._applied !== before) this._recost();
      return k;
    }

    /** Costs anew along the parents as they are: those who were born later come along, and are right again
     * when they are reached. */
    _recost() {
      const n = this.nodes, head = new Int32Array(n).fill(-1), next = new Int32Array(n).fill(-1);
      for (let i = n - 1; i > 0; i--) { next[i] = head[this.parent[i]]; head[this.parent[i]] = i; }
      const stack = [0];
      while (stack.length) {
        const v = stack.pop();
        for (let c = head[v]; c >= 0; c = next[c]) {
          this.cost[c] = this.cost[v] + this.distance(v, c);
          stack.push(c);
        }
      }
      this.version += 1;
    }

    _energyOf(v) {
      const { delta, tau } = this.header.target, optimum = this.header.optimum || 0;
      const off = Math.max(this.cost[v] + this.tau[v] - optimum, 0);
      return (off / delta + this.tau[v] / tau) / (optimum || 1);
    }

    _addEnergy(v) {
      const e = this._energyOf(v), last = this._lowest.length ? this._lowest[v - 1] : Infinity;
      this.energy.push(e);
      this._lowest.push(Math.min(last, Number.isNaN(e) ? Infinity : e));
    }

    /** Energies -log Q + constant of the nodes as they stand, and their least; null where nobody measured. */
    energies() {
      if (!this._measured) return null;
      const n = this.sizes[this.at];
      if (this._static) return { energy: this.energy, lowest: this._lowest[n - 1] };
      const key = `${n} ${this.version}`;
      if (this._energyKey === key) return this._energyMemo;
      const energy = new Float64Array(n), { delta, tau, normalisation } = this.header.target;
      if (normalisation === "tree") {
        let most = 0, far = 0;
        const optimum = this.header.optimum || 0;
        for (let v = 0; v < n; v++) {
          energy[v] = Math.max(this.cost[v] + this.tau[v] - optimum, 0);
          most = Math.max(most, energy[v]); far = Math.max(far, this.tau[v]);
        }
        for (let v = 0; v < n; v++) energy[v] = energy[v] / (most || 1) / delta + this.tau[v] / (far || 1) / tau;
      } else for (let v = 0; v < n; v++) energy[v] = this._energyOf(v);
      let lowest = Infinity;
      for (let v = 0; v < n; v++) if (energy[v] < lowest) lowest = energy[v];
      this._energyKey = key;
      this._energyMemo = { energy, lowest };
      return this._energyMemo;
    }

    /** The smoothed target Q of one node after `at` samples; NaN where nobody measured. */
    probability(node) {
      const found = this.energies();
      if (!found) return NaN;
      const n = this.sizes[this.at], epsilon = this.header.target.epsilon;
      if (epsilon * n >= 1) return 1 / n;
      let total = 0, least = 1;
      for (let v = 0; v < n; v++) {
        const w = Math.exp(found.lowest - found.energy[v]);
        total += w; least = Math.min(least, w);
      }
      const gamma = Math.max(0, (epsilon * total - least) / (1 - epsilon * n));
      return (Math.exp(found.lowest - found.energy[node]) + gamma) / (total + gamma * n);
    }

    // What the guides see.

    _pushView(row) {
      const events = this.views[row.view];
      if (!events) throw new Error(`no guide ${row.view}`);
      const at = this.samples;
      if (row.cells) events.push({ at, kind: "cells" });
      else if (row.graph) events.push({ at, kind: "graph", points: row.graph.points, edges: row.graph.edges });
      else if (row.field) events.push({ at, kind: "field", ...row.field });
      else if (row.weights) events.push({ at, kind: "weights", pairs: row.weights });
    }

    /** What a guide sees after `at` samples: {kind, ...} with a `version` that changes when it does; or null. */
    view(guide) {
      const events = this.views[guide] || [];
      let low = 0, high = events.length; // how many events there have been
      while (low < high) {
        const middle = (low + high) >> 1;
        if (events[middle].at <= this.at) low = middle + 1; else high = middle;
      }
      let base = low - 1;
      while (base >= 0 && events[base].kind === "weights") base -= 1;
      if (base < 0) return null;
      if (events[base].kind !== "graph") return { ...events[base], version: base };
      let state = this._states[guide];
      if (!state || state.base !== base || state.applied > low) {
        const count = events[base].edges.length;
        state = { base, applied: base + 1, weights: new Float64Array(count).fill(1) };
        this._states[guide] = state;
      }
      for (; state.applied < low; state.applied++) {
        for (const [edge, weight] of events[state.applied].pairs) state.weights[edge] = weight ?? Infinity;
      }
      return { ...events[base], weights: state.weights, version: low };
    }

    /** The guide of a sample (from 0); the first where only one guides. */
    guideOf(sample) {
      const g = this.guide[Math.max(0, sample)];
      return Number.isFinite(g) ? g : 0;
    }

    /** The path found, if the trace says one. */
    get path() { return (this.end && this.end.path) || null; }
  }

  // Canvases --------------------------------------------------------------------------------------------

  function ringPath(ctx, ring, scale, ox, oy) {
    ctx.moveTo(ox + ring[0] * scale, oy - ring[1] * scale);
    for (let i = 2; i < ring.length; i += 2) ctx.lineTo(ox + ring[i] * scale, oy - ring[i + 1] * scale);
    ctx.closePath();
  }

  const MARKS = 8; // pictures of a large tree that are kept while it grows
  const MANY = 3000; // nodes or failures from which on they are drawn pixel by pixel, some ten times as fast

  /** Lines and squares written straight into a canvas's pixels: not smooth, but fast. */
  class Raster {
    constructor(ctx) {
      this.ctx = ctx;
      this.image = ctx.createImageData(ctx.canvas.width, ctx.canvas.height);
      this.pixels = new Uint32Array(this.image.data.buffer);
    }

    static packed(colour, alpha = 1) { // "rgb(r,g,b)" or "#rrggbb", as four bytes
      const parts = colour[0] === "#" ? [1, 3, 5].map((i) => parseInt(colour.slice(i, i + 2), 16)) : colour.match(/\d+/g).map(Number);
      return new Uint32Array(new Uint8Array([...parts, Math.round(255 * alpha)]).buffer)[0];
    }

    /** A line of one pixel's width, or two; with `most`, lines add up where they cross, to that much at most. */
    line(x0, y0, x1, y1, colour, wide, most = 0) {
      const { pixels } = this, { data, width, height } = this.image;
      if ((x0 < 0 && x1 < 0) || (y0 < 0 && y1 < 0) || (x0 >= width && x1 >= width) || (y0 >= height && y1 >= height)) return;
      let dx = x1 - x0, dy = y1 - y0, from = 0, to = 1; // the part within the picture
      for (const [p, q] of [[-dx, x0], [dx, width - 1 - x0], [-dy, y0], [dy, height - 1 - y0]]) {
        if (p === 0) { if (q < 0) return; continue; }
        if (p < 0) from = Math.max(from, q / p); else to = Math.min(to, q / p);
      }
      if (from > to) return;
      x1 = x0 + to * dx; y1 = y0 + to * dy; x0 += from * dx; y0 += from * dy;
      dx = x1 - x0; dy = y1 - y0;
      const steps = Math.max(1, Math.ceil(Math.max(Math.abs(dx), Math.abs(dy)))), sx = dx / steps, sy = dy / steps;
      const beside = Math.abs(dx) > Math.abs(dy) ? width : 1, last = pixels.length;
      let x = x0 + 0.5, y = y0 + 0.5;
      for (let i = 0; i <= steps; i++, x += sx, y += sy) {
        const at = (y | 0) * width + (x | 0), before = most ? data[4 * at + 3] : 0;
        pixels[at] = colour;
        if (before) data[4 * at + 3] = Math.min(255 * most, before + data[4 * at + 3]);
        if (wide && at + beside < last) pixels[at + beside] = colour;
      }
    }

    show() { this.ctx.putImageData(this.image, 0, 0); }
  }

  /** Draws a problem, or a search after some samples, on a canvas that can be zoomed and moved. */
  class Stage {
    constructor(canvas, { theme = "light", layers = {} } = {}) {
      this.canvas = canvas;
      this.theme = theme;
      this.layers = { guide: true, tree: true, failures: true, choice: true, path: true, regions: false, ...layers };
      this.guide = -1; // whose view is shown: that of the last sample's
      this.sample = 0;
      this.trace = null;
      this.scene = null;
      this.hover = -1;
      this.onview = null; // called when the view has been moved
      this.onpress = null; // (world [x, y], event) => true to take a press for something else than moving
      this.onhover = null; // (node or -1)
      this._zoom = 1; this._centre = null;
      this._caches = {};
      this._listen();
    }

    setScene(scene) {
      this.scene = scene; this.trace = null;
      this.kinematics = kinematicsOf(scene.robot);
      this._centre = null; this._zoom = 1; this._caches = {};
    }

    setTrace(trace, sample = trace.samples) {
      const same = this.scene && JSON.stringify(this.scene.bounds) === JSON.stringify(trace.scene.bounds);
      const held = [this._centre, this._zoom];
      this.setScene(trace.scene);
      if (same) [this._centre, this._zoom] = held;
      this.trace = trace; this.sample = sample;
    }

    /** Say that the scene's obstacles or poses were changed in place. */
    touch() { this._caches = {}; if (this.scene) this.kinematics = kinematicsOf(this.scene.robot); }

    get colours() { return THEMES[this.theme]; }

    // The view.

    _measure() {
      const box = this.canvas.getBoundingClientRect(), ratio = Math.min(root.devicePixelRatio || 1, 2);
      const width = Math.max(1, Math.round(box.width * ratio)), height = Math.max(1, Math.round(box.height * ratio));
      if (this.canvas.width !== width || this.canvas.height !== height) {
        this.canvas.width = width; this.canvas.height = height;
      }
      this.ratio = ratio;
      const [xmin, ymin, xmax, ymax] = this.scene.bounds, margin = 10 * ratio;
      const fit = Math.min((width - 2 * margin) / (xmax - xmin), (height - 2 * margin) / (ymax - ymin));
      if (!this._centre) this._centre = [(xmin + xmax) / 2, (ymin + ymax) / 2];
      this.scale = Math.max(fit, 1e-9) * this._zoom;
      this.ox = width / 2 - this._centre[0] * this.scale;
      this.oy = height / 2 + this._centre[1] * this.scale;
      return `${width} ${height} ${this.scale} ${this.ox} ${this.oy} ${this.theme}`;
    }

    toScreen(x, y) { return [this.ox + x * this.scale, this.oy - y * this.scale]; }

    /** [x, y] in the workspace of a pointer's position. */
    toWorld(clientX, clientY) {
      const box = this.canvas.getBoundingClientRect();
      return [((clientX - box.left) * this.ratio - this.ox) / this.scale,
        (this.oy - (clientY - box.top) * this.ratio) / this.scale];
    }

    get view() { return { centre: this._centre && [...this._centre], zoom: this._zoom }; }
    set view({ centre, zoom }) { this._centre = centre && [...centre]; this._zoom = zoom; }

    fit() { this._centre = null; this._zoom = 1; this._moved(); }

    /** Zoom by a factor about a pointer's position, or about the middle. */
    zoom(factor, clientX = null, clientY = null) {
      if (!this._centre) return;
      const wanted = Math.min(200, Math.max(0.5, this._zoom * factor)), by = wanted / this._zoom;
      if (clientX !== null) {
        const [x, y] = this.toWorld(clientX, clientY);
        this._centre = [x + (this._centre[0] - x) / by, y + (this._centre[1] - y) / by];
      }
      this._zoom = wanted;
      this._moved();
    }

    /** Move by so many CSS pixels. */
    pan(dx, dy) {
      if (!this._centre) return;
      this._centre = [this._centre[0] - (dx * this.ratio) / this.scale, this._centre[1] + (dy * this.ratio) / this.scale];
      this._moved();
    }

    _moved() { this.draw(); if (this.onview) this.onview(this.view); }

    _listen() {
      const canvas = this.canvas, pointers = new Map();
      canvas.addEventListener("wheel", (event) => {
        event.preventDefault();
        this.zoom(Math.exp(-event.deltaY * (event.ctrlKey ? 0.01 : 0.0015)), event.clientX, event.clientY);
      }, { passive: false });
      canvas.addEventListener("pointerdown", (event) => {
        if (this.onpress && this.onpress(this.toWorld(event.clientX, event.clientY), event)) return;
        canvas.setPointerCapture(event.pointerId);
        pointers.set(event.pointerId, [event.clientX, event.clientY]);
      });
      canvas.addEventListener("pointermove", (event) => {
        const before = pointers.get(event.pointerId), now = [event.clientX, event.clientY];
        if (!before) return this._hovered(event);
        const other = [...pointers].find(([id]) => id !== event.pointerId);
        pointers.set(event.pointerId, now);
        if (other) { // pinch
          const [ox, oy] = other[1], span = (p) => Math.hypot(p[0] - ox, p[1] - oy) || 1;
          this.zoom(span(now) / span(before), (now[0] + ox) / 2, (now[1] + oy) / 2);
          this.pan((now[0] - before[0]) / 2, (now[1] - before[1]) / 2);
        } else this.pan(now[0] - before[0], now[1] - before[1]);
      });
      for (const name of ["pointerup", "pointercancel"]) {
        canvas.addEventListener(name, (event) => pointers.delete(event.pointerId));
      }
      canvas.addEventListener("pointerleave", () => this._hoverTo(-1));
      canvas.addEventListener("dblclick", (event) => this.zoom(2, event.clientX, event.clientY));
    }

    _hovered(event) {
      if (!this.trace || !this.onhover || event.pointerType === "touch") return;
      const [x, y] = this.toWorld(event.clientX, event.clientY);
      this._hoverTo(this.nodeNear(x, y, (12 * this.ratio) / this.scale));
    }

    _hoverTo(node) {
      if (node === this.hover || !this.onhover) return;
      this.hover = node;
      this.onhover(node);
      this.draw();
    }

    /** The node nearest to a point of the workspace, within a reach; -1 if there is none. */
    nodeNear(x, y, reach) {
      const { x: xs, y: ys } = this.trace, n = this.trace.sizes[this.sample];
      let best = -1, least = reach * reach;
      for (let i = 0; i < n; i++) {
        const square = (xs[i] - x) ** 2 + (ys[i] - y) ** 2;
        if (square < least) { least = square; best = i; }
      }
      return best;
    }

    // Drawing. What does not change is kept on canvases of its own.

    /** A kept canvas, and whether it has to be drawn anew because the key has changed. */
    _kept(name, key) {
      let kept = this._caches[name];
      if (!kept) {
        const canvas = document.createElement("canvas");
        kept = this._caches[name] = { canvas, ctx: canvas.getContext("2d"), key: null, count: 0, marks: [] };
      }
      if (kept.key === key) return [kept, false];
      if (kept.canvas.width !== this.canvas.width || kept.canvas.height !== this.canvas.height) {
        kept.canvas.width = this.canvas.width; kept.canvas.height = this.canvas.height;
      } else kept.ctx.clearRect(0, 0, kept.canvas.width, kept.canvas.height);
      kept.key = key; kept.count = 0;
      kept.raster = null; kept.marks = []; kept.moved = false;
      return [kept, true];
    }

    draw() {
      if (!this.scene) return;
      this.canvas.style.touchAction = this._zoom === 1 ? "pan-y" : "none"; // a finger still scrolls the page
      const key = this._measure(), ctx = this.canvas.getContext("2d"), trace = this.trace;
      if (!this.canvas.width) return;
      if (trace) this.sample = trace.seek(this.sample);
      ctx.drawImage(this._base(key), 0, 0);
      ctx.save();
      this._clip(ctx);
      if (trace && this.layers.guide) this._drawView(ctx, key);
      if (trace && this.layers.path) this._drawPath(ctx);
      if (trace && this.layers.failures) ctx.drawImage(this._failuresLayer(key), 0, 0);
      if (trace && this.layers.tree) ctx.drawImage(this._treeLayer(key), 0, 0);
      if (trace && this.layers.choice) this._drawChoice(ctx);
      if (trace && this.hover >= 0 && this.hover < trace.sizes[this.sample]) this._drawHover(ctx);
      ctx.restore();
      const { start, goal } = this.scene;
      if (start) this._robot(ctx, start, this.colours.start, 1.8, 0.35);
      if (goal) this._robot(ctx, goal, this.colours.goal, 1.8, 0.35);
    }

    _clip(ctx) {
      const [xmin, ymin, xmax, ymax] = this.scene.bounds, [x, y] = this.toScreen(xmin, ymax);
      ctx.beginPath();
      ctx.rect(x, y, (xmax - xmin) * this.scale, (ymax - ymin) * this.scale);
      ctx.clip();
    }

    _base(key) {
      const [kept, stale] = this._kept("base", `${key} ${this.layers.regions}`);
      if (!stale) return kept.canvas;
      const { ctx, canvas } = kept, { scene, colours, ratio } = this;
      ctx.fillStyle = colours.paper;
      ctx.fillRect(0, 0, canvas.width, canvas.height);
      ctx.save();
      this._clip(ctx);
      ctx.fillStyle = colours.free;
      ctx.fillRect(0, 0, canvas.width, canvas.height);
      if (this.layers.regions) this._drawRegions(ctx);
      this._drawObstacles(ctx);
      ctx.restore();
      const [xmin, ymin, xmax, ymax] = scene.bounds, [x, y] = this.toScreen(xmin, ymax);
      ctx.strokeStyle = colours.obstacle; ctx.lineWidth = ratio;
      ctx.strokeRect(x, y, (xmax - xmin) * this.scale, (ymax - ymin) * this.scale);
      return canvas;
    }

    /** Filled; those in space let through what is behind them, and show their outlines. */
    _drawObstacles(ctx) {
      const { colours, ratio, scene } = this, spatial = !!scene.robot.view;
      ctx.fillStyle = ctx.strokeStyle = colours.obstacle;
      ctx.lineWidth = ratio; ctx.lineJoin = "round";
      for (const rings of scene.obstacles) {
        ctx.beginPath();
        for (const ring of rings) ringPath(ctx, ring, this.scale, this.ox, this.oy);
        ctx.globalAlpha = spatial ? 0.22 : 1;
        ctx.fill("evenodd");
        ctx.globalAlpha = 1;
        if (spatial) ctx.stroke();
      }
    }

    _drawRegions(ctx) {
      const { colours, ratio } = this;
      ctx.font = `${12 * ratio}px system-ui, sans-serif`;
      for (const { name, polygons } of this.scene.regions) {
        ctx.beginPath();
        for (const rings of polygons) for (const ring of rings) ringPath(ctx, ring, this.scale, this.ox, this.oy);
        ctx.globalAlpha = 0.12; ctx.fillStyle = colours.region; ctx.fill("evenodd");
        ctx.globalAlpha = 0.9; ctx.strokeStyle = colours.region; ctx.setLineDash([4 * ratio, 3 * ratio]);
        ctx.lineWidth = ratio; ctx.stroke(); ctx.setLineDash([]);
        if (polygons.length) {
          const [x, y] = this.toScreen(polygons[0][0][0], polygons[0][0][1]);
          ctx.fillStyle = colours.muted;
          ctx.fillText(name, x + 4 * ratio, y - 4 * ratio);
        }
        ctx.globalAlpha = 1;
      }
    }

    /** The robot's outline at a configuration. */
    _robot(ctx, q, colour, width, fill = 0, dash = null) {
      const { ratio, scale, ox, oy } = this;
      ctx.save();
      ctx.strokeStyle = ctx.fillStyle = colour;
      ctx.lineWidth = width * ratio; ctx.lineJoin = "round"; ctx.lineCap = "round";
      if (dash) ctx.setLineDash(dash.map((v) => v * ratio));
      for (const { points, closed } of this.kinematics.place(q)) {
        ctx.beginPath();
        if (points.length === 2) {
          const [x, y] = this.toScreen(points[0], points[1]);
          ctx.arc(x, y, (fill ? 5 : 3.5) * ratio, 0, TURN);
          if (fill) ctx.fill(); else ctx.stroke();
          continue;
        }
        ctx.moveTo(ox + points[0] * scale, oy - points[1] * scale);
        for (let i = 2; i < points.length; i += 2) ctx.lineTo(ox + points[i] * scale, oy - points[i + 1] * scale);
        if (closed) {
          ctx.closePath();
          if (fill) { ctx.globalAlpha = fill; ctx.fill(); ctx.globalAlpha = 1; }
        }
        ctx.stroke();
      }
      ctx.restore();
    }

    _treeLayer(key) {
      const { trace } = this, n = trace.sizes[this.sample], found = trace.energies();
      const lowest = found ? found.lowest.toPrecision(6) : "", size = n <= 1000 ? 0 : n <= MANY ? 1 : 2;
      const own = `${key} ${lowest} ${trace.version} ${size}`;
      let [kept] = this._kept("tree", own);
      if (size === 2) this._toMark(kept, n);
      if (kept.count > n) { kept.key = null; [kept] = this._kept("tree", own); }
      if (kept.count === n && !kept.moved) return kept.canvas;
      if (size === 2) this._treePixels(kept, n, found);
      else this._treeLines(kept.ctx, this._byLevel(kept.count, n, found), size, found);
      kept.count = n;
      return kept.canvas;
    }

    /** The nodes from `first` to `n`, the best last: `order`, the `level` of each, and where levels begin. */
    _byLevel(first, n, found) {
      const count = n - first, levels = new Uint8Array(count), begins = new Uint32Array(LEVELS + 1);
      for (let i = 0; i < count; i++) {
        const off = found ? (found.energy[first + i] - found.lowest) / FLOOR : 0;
        levels[i] = Math.round((1 - Math.min(1, Math.max(0, off || 0))) * (LEVELS - 1));
        begins[levels[i] + 1] += 1;
      }
      for (let i = 0; i < LEVELS; i++) begins[i + 1] += begins[i];
      const next = begins.slice(), order = new Uint32Array(count);
      for (let i = 0; i < count; i++) order[next[levels[i]]++] = first + i;
      return { order, begins, level: (v) => levels[v - first] };
    }

    _treeLines(ctx, { order, begins }, size, found) {
      const { trace: { x, y, parent }, colours, ratio, scale, ox, oy } = this, r = (size ? 1.4 : 2.1) * ratio;
      ctx.lineWidth = 1.3 * ratio;
      for (let level = 0; level < LEVELS; level++) {
        if (begins[level] === begins[level + 1]) continue;
        ctx.strokeStyle = ctx.fillStyle = found ? colours.levels[level] : colours.ink;
        ctx.beginPath();
        for (let i = begins[level]; i < begins[level + 1]; i++) {
          const v = order[i], p = parent[v];
          if (p < 0) continue;
          ctx.moveTo(ox + x[p] * scale, oy - y[p] * scale);
          ctx.lineTo(ox + x[v] * scale, oy - y[v] * scale);
        }
        ctx.stroke();
        ctx.beginPath();
        for (let i = begins[level]; i < begins[level + 1]; i++) {
          const v = order[i], cx = ox + x[v] * scale, cy = oy - y[v] * scale;
          ctx.moveTo(cx + r, cy);
          ctx.arc(cx, cy, r, 0, TURN);
        }
        ctx.fill();
      }
    }

    /** The nodes up to `n` as lines of pixels, for trees of very many. Marks are left on the way, to go back to. */
    _treePixels(kept, n, found) {
      const { trace: { x, y, parent, nodes }, colours, scale, ox, oy } = this, wide = this.ratio >= 1.5;
      const palette = found ? colours.levels.map(Raster.packed) : new Array(LEVELS).fill(Raster.packed(colours.ink));
      const raster = (kept.raster = kept.raster || new Raster(kept.ctx)), step = Math.ceil(nodes / MARKS);
      while (kept.count < n) {
        const end = Math.min(n, (Math.floor(kept.count / step) + 1) * step), { order, level } = this._byLevel(kept.count, end, found);
        for (const v of order) {
          const p = parent[v];
          if (p >= 0) raster.line(ox + x[p] * scale, oy - y[p] * scale, ox + x[v] * scale, oy - y[v] * scale, palette[level(v)], wide);
        }
        kept.count = end;
        if (end % step === 0 && kept.marks.length < MARKS && !kept.marks.some((mark) => mark.count === end)) {
          kept.marks.push({ count: end, pixels: raster.pixels.slice() });
        }
      }
      raster.show();
      kept.moved = false;
    }

    /** Back, or on, to the picture of the last mark that has no more than `n` nodes. */
    _toMark(kept, n) {
      const mark = kept.marks.reduce((best, one) => (one.count <= n && one.count > best.count ? one : best), { count: 0 });
      if (!mark.count || (kept.count <= n && kept.count >= mark.count)) return;
      kept.raster.pixels.set(mark.pixels);
      kept.count = mark.count;
      kept.moved = true; // the canvas does not show it yet
    }

    _failuresLayer(key) {
      const { trace, ratio } = this, n = trace.failures[this.sample];
      let [kept] = this._kept("failures", key);
      if (kept.count > n) { kept.key = null; [kept] = this._kept("failures", key); }
      const { ctx } = kept, r = 1.6 * ratio;
      if (n - kept.count > MANY) return this._failurePixels(kept, n, Math.round(r));
      ctx.fillStyle = this.colours.failure;
      ctx.globalAlpha = 0.28;
      for (let i = kept.count; i < n; i++) {
        const [x, y] = this.toScreen(trace.fx[i], trace.fy[i]);
        ctx.fillRect(x - r, y - r, 2 * r, 2 * r);
      }
      ctx.globalAlpha = 1;
      kept.count = n;
      return kept.canvas;
    }

    /** Many failures at once: the more lie on a pixel, the stronger it is. */
    _failurePixels(kept, n, r) {
      const raster = new Raster(kept.ctx), { width, height, data } = raster.image, { fx, fy } = this.trace;
      const colour = Raster.packed(this.colours.failure);
      for (let i = 0; i < n; i++) {
        const cx = Math.round(this.ox + fx[i] * this.scale), cy = Math.round(this.oy - fy[i] * this.scale);
        for (let y = Math.max(0, cy - r); y < Math.min(height, cy + r); y++) {
          for (let x = Math.max(0, cx - r); x < Math.min(width, cx + r); x++) {
            const at = y * width + x, alpha = data[4 * at + 3];
            raster.pixels[at] = colour;
            data[4 * at + 3] = alpha + 0.28 * (255 - alpha);
          }
        }
      }
      raster.show();
      kept.count = n;
      return kept.canvas;
    }

    /** The last sample: the selected node, the try, and its contact if it failed. */
    _drawChoice(ctx) {
      const { trace, colours, ratio } = this, k = this.sample - 1;
      if (k < 0) return;
      const node = trace.node[k], { target, contact } = trace.attempt(k);
      const [x, y] = this.toScreen(trace.x[node], trace.y[node]);
      const tip = trace.kinematics.tip(contact || target), [tx, ty] = this.toScreen(tip[0], tip[1]);
      const aim = trace.kinematics.tip(target), [ax, ay] = this.toScreen(aim[0], aim[1]);
      const colour = contact ? colours.failure : colours.ink;
      this._robot(ctx, trace.configuration(node), colours.halo, 4.5);
      this._robot(ctx, trace.configuration(node), colours.ink, 1.6);
      this._robot(ctx, contact || target, colour, 1.2, 0, contact ? [4, 3] : null);
      ctx.lineCap = "round";
      for (const [style, width] of [[colours.halo, 5], [colour, 2.2]]) {
        ctx.strokeStyle = style; ctx.lineWidth = width * ratio;
        ctx.beginPath(); ctx.moveTo(x, y); ctx.lineTo(tx, ty); ctx.stroke();
      }
      if (contact) { // what was left of the motion, and a cross where it ended
        ctx.setLineDash([3 * ratio, 4 * ratio]); ctx.lineWidth = 1.4 * ratio;
        ctx.beginPath(); ctx.moveTo(tx, ty); ctx.lineTo(ax, ay); ctx.stroke(); ctx.setLineDash([]);
        const r = 5 * ratio;
        ctx.lineWidth = 2.2 * ratio;
        ctx.beginPath();
        ctx.moveTo(tx - r, ty - r); ctx.lineTo(tx + r, ty + r); ctx.moveTo(tx + r, ty - r); ctx.lineTo(tx - r, ty + r);
        ctx.stroke();
      } else {
        ctx.fillStyle = colour;
        ctx.beginPath(); ctx.arc(tx, ty, 3.4 * ratio, 0, TURN); ctx.fill();
      }
      ctx.strokeStyle = colours.ink; ctx.lineWidth = 2 * ratio;
      ctx.beginPath(); ctx.arc(x, y, 7 * ratio, 0, TURN); ctx.stroke();
    }

    _drawHover(ctx) {
      const { trace, colours, ratio } = this;
      ctx.strokeStyle = colours.start; ctx.lineWidth = 2.4 * ratio; ctx.beginPath();
      for (let v = this.hover, left = trace.nodes; v >= 0 && left > 0; v = trace.parent[v], left--) {
        const [x, y] = this.toScreen(trace.x[v], trace.y[v]);
        if (v === this.hover) ctx.moveTo(x, y); else ctx.lineTo(x, y);
      }
      ctx.stroke();
      this._robot(ctx, trace.configuration(this.hover), colours.start, 1.6);
    }

    /** The path found, once the search has ended, with the robot along it. */
    _drawPath(ctx) {
      const { trace, colours, ratio } = this, path = trace.path;
      if (!path || path.length < 2 || this.sample < trace.samples) return;
      const bent = trace.scene.robot.bodies.length > 1; // straight in C, not in the workspace
      const points = (bent ? [path[0], ...this.along(path, 150), path.at(-1)] : path).map((q) => { const [x, y] = trace.kinematics.tip(q); return this.toScreen(x, y); });
      ctx.lineJoin = ctx.lineCap = "round";
      ctx.strokeStyle = colours.path; ctx.globalAlpha = 0.4; ctx.lineWidth = 7 * ratio;
      ctx.beginPath();
      points.forEach(([x, y], i) => (i ? ctx.lineTo(x, y) : ctx.moveTo(x, y)));
      ctx.stroke();
      ctx.globalAlpha = 1;
      for (const q of this.along(path)) this._robot(ctx, q, colours.path, 1.1);
    }

    /** Configurations along a path, spaced so that the robot can be told apart. */
    along(path, count = 14) {
      const { trace } = this, steps = [];
      let total = 0;
      for (let i = 1; i < path.length; i++) {
        const change = trace.difference(path[i - 1], path[i]);
        const length = Math.sqrt(change.reduce((sum, c, k) => sum + (c * trace.weights[k]) ** 2, 0));
        steps.push({ from: path[i - 1], change, length, begin: total });
        total += length;
      }
      const out = [];
      for (let k = 1; k < count; k++) {
        const s = (k / count) * total, step = steps.find((one) => s <= one.begin + one.length) || steps.at(-1);
        const t = step.length ? (s - step.begin) / step.length : 0;
        out.push(step.from.map((v, i) => v + t * step.change[i]));
      }
      return out;
    }

    // The guide's view.

    _drawView(ctx, key) {
      const guide = this.guide >= 0 ? this.guide : this.trace.guideOf(this.sample ? this.sample - 1 : 0);
      const view = this.trace.view(guide);
      if (!view) return;
      const size = view.kind === "cells" ? this.trace.sizes[this.sample] : view.version;
      const [kept, stale] = this._kept("view", `${key} ${guide} ${view.kind} ${size}`);
      if (stale) {
        if (view.kind === "graph") this._drawGraph(kept.ctx, view);
        else this._drawImage(kept.ctx, view.kind === "cells" ? this._cells() : this._field(view));
        if (view.kind !== "graph") this._drawObstacles(kept.ctx);
      }
      ctx.drawImage(kept.canvas, 0, 0);
    }

    _drawGraph(ctx, { points, edges, weights }) {
      const { colours, ratio, scale, ox, oy } = this, many = edges.length > MANY, raster = many && new Raster(ctx);
      const groups = new Map();
      for (let e = 0; e < edges.length; e++) {
        const w = weights[e], level = w === Infinity ? 9 : w <= 1.0001 ? 0 : Math.min(3, 1 + Math.floor(Math.log(w) / Math.log(3)));
        if (!groups.has(level)) groups.set(level, []);
        groups.get(level).push(e);
      }
      for (const [level, members] of [...groups].sort((a, b) => a[0] - b[0])) {
        const removed = level === 9;
        if (many) {
          const deep = this.scene.robot.view ? 0.5 : 1; // in space, many lie behind each other
          const faint = deep * Math.min(0.4, Math.max(0.1, (0.4 * MANY) / edges.length)); // the more, the fainter each
          const colour = Raster.packed(removed ? colours.failure : level ? colours.heavy[level - 1] : colours.graph, removed ? 0.26 : level ? 0.6 : faint);
          for (const e of members) {
            const [a, b] = [points[edges[e][0]], points[edges[e][1]]];
            raster.line(ox + a[0] * scale, oy - a[1] * scale, ox + b[0] * scale, oy - b[1] * scale, colour, level && !removed, level ? 0 : 0.5 * deep);
          }
          continue;
        }
        ctx.strokeStyle = removed ? colours.failure : level ? colours.heavy[level - 1] : colours.graph;
        ctx.globalAlpha = removed ? 0.35 : level ? 0.9 : 0.65;
        ctx.lineWidth = (removed ? 0.6 : level ? 1 + 0.5 * level : 1.4) * ratio;
        ctx.setLineDash(removed ? [2 * ratio, 3 * ratio] : []);
        ctx.beginPath();
        for (const e of members) {
          const [a, b] = edges[e];
          ctx.moveTo(ox + points[a][0] * scale, oy - points[a][1] * scale);
          ctx.lineTo(ox + points[b][0] * scale, oy - points[b][1] * scale);
        }
        ctx.stroke();
      }
      ctx.setLineDash([]); ctx.globalAlpha = 1;
      if (many) raster.show();
    }

    _drawImage(ctx, { image, bounds, smooth }) {
      const [x, y] = this.toScreen(bounds[0], bounds[3]);
      ctx.imageSmoothingEnabled = smooth;
      ctx.drawImage(image, x, y, (bounds[2] - bounds[0]) * this.scale, (bounds[3] - bounds[1]) * this.scale);
    }

    /** h as shades in twelve steps, the strongest where it is least; nothing where there is no way. */
    _field({ rows, columns, bounds, values }) {
      const bytes = Uint8Array.from(atob(values), (c) => c.charCodeAt(0));
      return { bounds, smooth: false, image: this._shaded(rows, columns, (i) => {
        if (bytes[i] === 255) return 0;
        const step = Math.floor((bytes[i] / 255) * 12) / 12;
        return 0.62 * (1 - step) + 0.04;
      }) };
    }

    _shaded(rows, columns, alphaOf) {
      const image = document.createElement("canvas");
      image.width = columns; image.height = rows;
      const ctx = image.getContext("2d"), data = ctx.createImageData(columns, rows), [r, g, b] = this.colours.field;
      for (let row = 0; row < rows; row++) {
        for (let column = 0; column < columns; column++) {
          const o = 4 * ((rows - 1 - row) * columns + column);
          data.data[o] = r; data.data[o + 1] = g; data.data[o + 2] = b;
          data.data[o + 3] = 255 * alphaOf(row * columns + column);
        }
      }
      ctx.putImageData(data, 0, 0);
      return image;
    }

    /** The workspace's cells around the nodes, the stronger the larger. Each new node takes its cell from the
     * others, pixel by pixel from its own place outwards. */
    _cells() {
      const bounds = this.scene.bounds, [xmin, ymin, xmax, ymax] = bounds, n = this.trace.sizes[this.sample];
      let grid = this._caches.cells;
      if (!grid) {
        const cell = Math.max(xmax - xmin, ymax - ymin) / 280, columns = Math.max(1, Math.round((xmax - xmin) / cell));
        const rows = Math.max(1, Math.round((ymax - ymin) / cell)), size = rows * columns;
        grid = this._caches.cells = { count: 0, rows, columns, owner: new Int32Array(size).fill(-1),
          room: new Float32Array(size).fill(Infinity), seen: new Int32Array(size).fill(-1), areas: [], stack: new Int32Array(size), log: [], starts: [], stamp: 0 };
      }
      while (grid.count > n) this._giveCellBack(grid, --grid.count);
      for (; grid.count < n; grid.count++) this._takeCell(grid, grid.count);
      const { rows, columns, owner, areas } = grid, most = Math.max(1, areas.reduce((a, b) => Math.max(a, b), 1));
      return { bounds, smooth: true, image: this._shaded(rows, columns, (i) => {
        const v = owner[i], right = (i + 1) % columns ? owner[i + 1] : v, above = i + columns < owner.length ? owner[i + columns] : v;
        return v < 0 ? 0 : v !== right || v !== above ? 0.5 : 0.03 + 0.4 * (areas[v] / most);
      }) };
    }

    _giveCellBack({ owner, room, areas, log, starts }, v) {
      while (log.length > starts[v]) {
        const before = log.pop(), square = log.pop(), at = log.pop();
        owner[at] = before; room[at] = square;
        if (before >= 0) areas[before] += 1;
      }
      areas.length = v;
    }

    _takeCell(grid, v) {
      const { rows, columns, owner, room, seen, areas, stack, log, starts } = grid, stamp = grid.stamp++;
      const [xmin, ymin, xmax, ymax] = this.scene.bounds;
      const px = ((this.trace.x[v] - xmin) / (xmax - xmin)) * columns - 0.5, py = ((this.trace.y[v] - ymin) / (ymax - ymin)) * rows - 0.5;
      const first = Math.min(rows - 1, Math.max(0, Math.round(py))) * columns + Math.min(columns - 1, Math.max(0, Math.round(px)));
      let top = 0;
      areas[v] = 0; starts[v] = log.length;
      stack[top++] = first; seen[first] = stamp;
      while (top) {
        const at = stack[--top], c = at % columns, r = (at - c) / columns, square = (px - c) ** 2 + (py - r) ** 2;
        if (square >= room[at]) continue;
        log.push(at, room[at], owner[at]);
        room[at] = square;
        if (owner[at] >= 0) areas[owner[at]] -= 1;
        owner[at] = v; areas[v] += 1;
        if (c > 0 && seen[at - 1] !== stamp) { seen[at - 1] = stamp; stack[top++] = at - 1; }
        if (c + 1 < columns && seen[at + 1] !== stamp) { seen[at + 1] = stamp; stack[top++] = at + 1; }
        if (r > 0 && seen[at - columns] !== stamp) { seen[at - columns] = stamp; stack[top++] = at - columns; }
        if (r + 1 < rows && seen[at + columns] !== stamp) { seen[at + columns] = stamp; stack[top++] = at + columns; }
      }
    }
  }

  // Curves ----------------------------------------------------------------------------------------------

  /** SE over samples of one trace or two: each sample, their running mean, and the best possible. */
  class Curve {
    constructor(canvas, traces, { theme = "light" } = {}) {
      this.canvas = canvas; this.traces = traces; this.theme = theme;
      this.sample = 0;
      this.onseek = null; // (sample) when somebody points at one
      const point = (event) => {
        if (!this.onseek || !(event.buttons & 1)) return;
        const box = canvas.getBoundingClientRect(), { left, width } = this._plot(1);
        this.onseek(Math.round(Math.min(1, Math.max(0, (event.clientX - box.left - left) / width)) * this.length));
      };
      canvas.addEventListener("pointerdown", (event) => { canvas.setPointerCapture(event.pointerId); point(event); });
      canvas.addEventListener("pointermove", point);
    }

    get length() { return Math.max(1, ...this.traces.map((trace) => trace.samples)); }

    _plot(ratio) {
      const width = this.canvas.getBoundingClientRect().width * ratio, height = this.canvas.getBoundingClientRect().height * ratio;
      const left = 34 * ratio, top = 8 * ratio;
      return { left, top, width: Math.max(1, width - left - 8 * ratio), height: Math.max(1, height - top - 20 * ratio) };
    }

    draw() {
      const box = this.canvas.getBoundingClientRect(), ratio = Math.min(root.devicePixelRatio || 1, 2);
      const width = Math.round(box.width * ratio), height = Math.round(box.height * ratio);
      if (!width || !height) return;
      const shape = this.traces.map((trace) => trace.samples).join();
      const key = `${width} ${height} ${this.theme} ${shape}`;
      if (this._key !== key) {
        this.canvas.width = width; this.canvas.height = height;
        this._kept = this._kept || document.createElement("canvas");
        this._kept.width = width; this._kept.height = height;
        this._drawCurves(this._kept.getContext("2d"), ratio);
        this._key = key;
      }
      const ctx = this.canvas.getContext("2d"), { left, top, width: w, height: h } = this._plot(ratio);
      ctx.clearRect(0, 0, width, height);
      ctx.drawImage(this._kept, 0, 0);
      const x = left + (this.sample / this.length) * w, colours = THEMES[this.theme];
      ctx.strokeStyle = colours.ink; ctx.lineWidth = 1.5 * ratio;
      ctx.beginPath(); ctx.moveTo(x, top); ctx.lineTo(x, top + h); ctx.stroke();
      this.traces.forEach((trace, i) => {
        const value = trace.se[this.sample - 1];
        if (!Number.isFinite(value)) return;
        ctx.fillStyle = colours.series[i]; ctx.strokeStyle = colours.paper; ctx.lineWidth = 1.5 * ratio;
        ctx.beginPath(); ctx.arc(x, top + h * (1 - value / this._most), 4.5 * ratio, 0, TURN); ctx.fill(); ctx.stroke();
      });
    }

    _drawCurves(ctx, ratio) {
      const colours = THEMES[this.theme], { left, top, width, height } = this._plot(ratio), m = this.length;
      let most = 1;
      for (const trace of this.traces) for (const v of trace.se) if (v > most) most = v;
      this._most = most;
      ctx.font = `${11 * ratio}px system-ui, sans-serif`;
      ctx.fillStyle = colours.muted; ctx.strokeStyle = colours.grid; ctx.lineWidth = ratio;
      ctx.textAlign = "right"; ctx.textBaseline = "middle";
      const step = most > 6 ? 3 : most > 3 ? 2 : 1;
      for (let v = 0; v <= most; v += step) {
        const y = top + height * (1 - v / most);
        ctx.beginPath(); ctx.moveTo(left, y); ctx.lineTo(left + width, y); ctx.stroke();
        ctx.fillText(String(v), left - 6 * ratio, y);
      }
      ctx.textAlign = "left"; ctx.textBaseline = "top"; ctx.fillText("0", left, top + height + 4 * ratio);
      ctx.textAlign = "right"; ctx.fillText(`${m} samples`, left + width, top + height + 4 * ratio);
      this.traces.forEach((trace, i) => this._drawSeries(ctx, trace, colours.series[i], ratio, i));
    }

    _drawSeries(ctx, trace, colour, ratio, number) {
      const { left, top, width, height } = this._plot(ratio), m = this.length, n = trace.samples;
      const at = (k, v) => [left + (k / m) * width, top + height * (1 - v / this._most)];
      ctx.fillStyle = ctx.strokeStyle = colour;
      ctx.globalAlpha = Math.max(0.05, Math.min(0.6, 300 / n));
      const r = (n > 400 ? 1 : 1.7) * ratio;
      for (let k = 0; k < n; k++) {
        if (!Number.isFinite(trace.se[k])) continue;
        const [x, y] = at(k + 1, trace.se[k]);
        ctx.fillRect(x - r, y - r, 2 * r, 2 * r);
      }
      ctx.globalAlpha = 1;
      const line = (values, window) => {
        ctx.beginPath();
        let sum = 0, begun = false;
        const every = Math.max(1, Math.floor(n / (2 * width)));
        for (let k = 0; k < n; k++) {
          sum += values[k] - (k >= window ? values[k - window] : 0);
          if (!Number.isFinite(sum)) { return; }
          if (k % every && k !== n - 1) continue;
          const [x, y] = at(k + 1, sum / Math.min(k + 1, window));
          if (begun) ctx.lineTo(x, y); else ctx.moveTo(x, y);
          begun = true;
        }
        ctx.stroke();
      };
      ctx.lineWidth = 1.8 * ratio;
      ctx.setLineDash(number ? [7 * ratio, 3 * ratio] : []);
      line(trace.se, Math.max(1, Math.round(n / 25)));
      ctx.lineWidth = ratio; ctx.setLineDash([2 * ratio, 3 * ratio]); ctx.strokeStyle = THEMES[this.theme].muted;
      line(trace.best, Math.max(1, Math.round(n / 25)));
      ctx.setLineDash([]);
    }
  }

  root.GuidedGym = { ...(root.GuidedGym || {}), FORMAT, THEMES, Kinematics, Trace, Stage, Curve };
})(typeof globalThis !== "undefined" ? globalThis : window);
