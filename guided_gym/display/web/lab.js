/* guided-gym: the lab's page. Draws a problem (a document: the content of a problem file), has the server
 * search it, and shows the searches as they run. Needs view.js and player.js. All names are shown as text. */
"use strict";
(function () {
  const G = window.GuidedGym, { make } = G, $ = (id) => document.getElementById(id);
  const KEPT = "guided-gym lab", UNDO = 200, MOST_GUIDANCES = 4, MOST_RUNS = 12, NEAR = 11, NEAR_FINGER = 18; // pixels
  const TOOLS = [["move", "Move", "m", "Drag start, goal, obstacles and their corners; drag beside them to move the view."],
    ["box", "Box", "b", "Drag from corner to corner."],
    ["polygon", "Polygon", "p", "Point at the corners one by one; end at the first one, or with Enter. Esc gives up."]];
  const ROBOTS = { rectangle: "rectangle", segment: "stick", point: "point", polygon: "L shape" };
  const copy = (value) => JSON.parse(JSON.stringify(value));
  const degrees = (value) => Number(((value * 180) / Math.PI).toFixed(3));

  // The server -------------------------------------------------------------------------------------------

  async function ask(path, body) {
    const options = body === undefined ? {} : { method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(body) };
    let response;
    try { response = await fetch(`api/${path}`, options); } catch { throw new Error("The lab's server does not answer; is it still running?"); }
    const answer = await response.json().catch(() => ({ error: `the server answered ${response.status}` }));
    if (answer.error) throw new Error(answer.error);
    return answer;
  }

  function say(text, bad = false, ...more) {
    $("message").className = bad ? "message bad" : "message";
    $("message").replaceChildren(text, ...more);
  }

  // The document -----------------------------------------------------------------------------------------

  let about = null; // what the server said at the start
  let doc = null; // the problem, as its file says it
  let view = { robot: null, metric: null, trouble: null };
  let selected = null; // {kind: "start" | "goal" | "obstacle", index}
  let tool = "move", drawn = null; // corners of a polygon that is being drawn, or of a box
  const undone = [], done = [];

  /** Change the document: kept for undo, checked, and drawn. */
  function change(act) {
    const before = JSON.stringify(doc);
    act();
    settle(before);
  }

  function settle(before) {
    if (JSON.stringify(doc) === before) return;
    done.push(before);
    if (done.length > UNDO) done.shift();
    undone.length = 0;
    changed();
  }

  function changed() {
    if (selected && selected.kind === "obstacle" && selected.index >= doc.obstacles.length) selected = null;
    keep();
    fill();
    redraw();
    check();
  }

  function travel(from, to) {
    if (!from.length) return;
    to.push(JSON.stringify(doc));
    doc = JSON.parse(from.pop());
    changed();
  }

  function keep() {
    try { localStorage.setItem(KEPT, JSON.stringify({ doc, name: $("name").value, folder: about.folder })); } catch { /* full, or off */ }
  }

  function kept() {
    try {
      const found = JSON.parse(localStorage.getItem(KEPT));
      return found && found.folder === about.folder && found.doc && Array.isArray(found.doc.bounds) ? found : null;
    } catch { return null; }
  }

  function take(found, name) {
    found.obstacles = (found.obstacles || []).map((part) => ({ ...part, holes: part.holes || [] }));
    if (doc) { done.push(JSON.stringify(doc)); undone.length = 0; }
    doc = found;
    selected = null; drawn = null;
    $("name").value = name;
    if (!view.robot) $("hint").textContent = "Getting ready … (the first time on a machine, kernels compile for up to a minute)";
    stage.setScene({ ...scene(), robot: view.robot || { joints: [], bodies: [], tip: { joint: -1, point: [0, 0] } }, start: null, goal: null });
    view = { ...view, robot: null };
    changed();
  }

  let asked = 0, timer = 0;
  function check() {
    clearTimeout(timer);
    timer = setTimeout(async () => {
      const mine = ++asked;
      try {
        const answer = await ask("view", { document: doc });
        if (mine !== asked) return;
        if (!view.robot) use(tool); // says what it does
        view = { ...answer, robot: answer.robot || view.robot, metric: answer.metric || view.metric };
        $("trouble").textContent = answer.trouble || "";
        fit(answer.robot);
        fill();
        redraw();
      } catch (error) { if (mine === asked) $("trouble").textContent = error.message; }
    }, 60);
  }

  /** Start and goal with as many numbers as the robot has. */
  function fit(robot) {
    if (!robot || doc.start.length === robot.dimension) return;
    for (const name of ["start", "goal"]) {
      doc[name] = Array.from({ length: robot.dimension }, (_, i) => doc[name][i] ?? 0);
    }
    check();
  }

  const flat = (ring) => ring.flat();
  function scene() {
    return { name: doc.name || "problem", bounds: doc.bounds, regions: [], tolerance: 0,
      obstacles: doc.obstacles.map((part) => [flat(part.polygon), ...part.holes.map(flat)]),
      robot: view.robot, metric: view.metric,
      start: view.robot && doc.start.length === view.robot.dimension ? doc.start : null,
      goal: view.robot && doc.goal.length === view.robot.dimension ? doc.goal : null };
  }

  // The drawing ------------------------------------------------------------------------------------------

  class EditStage extends G.Stage {
    draw() {
      super.draw();
      this.canvas.style.touchAction = "none";
      if (this.scene && this.scene.robot) this.overlay(this.canvas.getContext("2d"));
    }

    overlay(ctx) {
      const { ratio, colours } = this;
      ctx.strokeStyle = colours.start; ctx.fillStyle = colours.paper; ctx.lineWidth = 2 * ratio;
      if (selected && selected.kind === "obstacle") {
        for (const ring of rings(doc.obstacles[selected.index])) this.line(ctx, ring, true);
        for (const [x, y] of rings(doc.obstacles[selected.index]).flat()) {
          const [sx, sy] = this.toScreen(x, y), r = 4.5 * ratio;
          ctx.fillRect(sx - r, sy - r, 2 * r, 2 * r); ctx.strokeRect(sx - r, sy - r, 2 * r, 2 * r);
        }
      }
      for (const name of ["start", "goal"]) {
        const handle = turnHandle(name);
        if (!handle) continue;
        ctx.strokeStyle = colours[name];
        const [x, y] = this.toScreen(...handle.at), [cx, cy] = this.toScreen(...handle.centre);
        ctx.globalAlpha = selected && selected.kind === name ? 1 : 0.6;
        ctx.beginPath(); ctx.moveTo(cx, cy); ctx.lineTo(x, y); ctx.stroke();
        ctx.beginPath(); ctx.arc(x, y, 5.5 * ratio, 0, 2 * Math.PI); ctx.fill(); ctx.stroke();
        ctx.globalAlpha = 1;
      }
      if (drawn && drawn.length) {
        ctx.strokeStyle = colours.start;
        ctx.setLineDash([6 * ratio, 4 * ratio]);
        this.line(ctx, tool === "box" ? boxRing(drawn) : drawn, tool === "box");
        ctx.setLineDash([]);
        if (tool === "polygon") for (const [x, y] of drawn) {
          const [sx, sy] = this.toScreen(x, y);
          ctx.beginPath(); ctx.arc(sx, sy, 5 * ratio, 0, 2 * Math.PI); ctx.fill(); ctx.stroke();
        }
      }
    }

    line(ctx, points, closed) {
      ctx.beginPath();
      points.forEach(([x, y], i) => { const p = this.toScreen(x, y); if (i) ctx.lineTo(...p); else ctx.moveTo(...p); });
      if (closed) ctx.closePath();
      ctx.stroke();
    }
  }

  const rings = (part) => [part.polygon, ...part.holes];
  const boxRing = ([[a, b], [c, d]]) => {
    const [x0, x1, y0, y1] = [Math.min(a, c), Math.max(a, c), Math.min(b, d), Math.max(b, d)];
    return [[x0, y0], [x1, y0], [x1, y1], [x0, y1]];
  };
  const canvas = $("editor"), stage = new EditStage(canvas);
  const pixel = () => stage.ratio / stage.scale; // in the workspace's unit
  let near = NEAR; // how far from a thing a press takes hold of it; more for a finger
  const apart = ([a, b], [c, d]) => Math.hypot(a - c, b - d);
  /** A number with no more digits than a pixel has. */
  const tidy = (value) => { const unit = 10 ** Math.floor(Math.log10(pixel())); return Number((Math.round(value / unit) * unit).toPrecision(12)); };

  function redraw() {
    if (!doc || !view.robot) return;
    stage.scene = scene();
    stage.touch();
    canvas.style.aspectRatio = String(Math.min(3, Math.max(0.7, (doc.bounds[2] - doc.bounds[0]) / (doc.bounds[3] - doc.bounds[1]))));
    stage.draw();
    canvas.setAttribute("aria-label", `${doc.name || "problem"}: ${doc.obstacles.length} obstacles; selected: ${selectionName()}`);
  }

  function selectionName() {
    if (!selected) return "nothing";
    return selected.kind === "obstacle" ? doc.obstacles[selected.index].name || `obstacle ${selected.index}` : selected.kind;
  }

  // Which coordinates a robot moves and turns by; an arm has no first two.
  const jointOf = (kind) => (view.robot ? view.robot.joints.findIndex((joint) => joint.kind === kind && joint.coordinate >= 0) : -1);
  const moves = () => jointOf("x") >= 0 && jointOf("y") >= 0;
  const coordinate = (joint) => view.robot.joints[joint].coordinate;

  function frameOf(name, joint) { // [x, y] of a joint
    stage.kinematics.place(doc[name]);
    return [...stage.kinematics.frames.subarray(4 * (joint + 1), 4 * (joint + 1) + 2)];
  }

  function turnHandle(name) {
    const joint = jointOf("turn");
    if (!stage.scene[name] || joint < 0 || !moves()) return null;
    const centre = frameOf(name, joint), angle = doc[name][coordinate(joint)];
    const points = stage.kinematics.place(doc[name]).flatMap(({ points: p }) => [...p]);
    let radius = 0;
    for (let i = 0; i < points.length; i += 2) radius = Math.max(radius, apart([points[i], points[i + 1]], centre));
    return { joint, centre, at: placeOfHandle(centre, angle, radius + 22 * pixel()) };
  }

  /** Ahead of the robot; where the canvas ends before that, behind or beside it, or nearer. */
  function placeOfHandle([x, y], angle, radius) {
    const margin = 8 * stage.ratio, inSight = (point) => {
      const [sx, sy] = stage.toScreen(...point);
      return Math.min(sx, sy, canvas.width - sx, canvas.height - sy) >= margin;
    };
    const places = [1, 0.75, 0.5, 0.25].flatMap((share) => [0, 2, 1, 3].map((quarter) => {
      const way = angle + (quarter * Math.PI) / 2, r = share * radius;
      return [x + r * Math.cos(way), y + r * Math.sin(way)];
    }));
    return places.find(inSight) || places[0];
  }

  function inside([x, y], flatRing) {
    let odd = false;
    for (let i = 0, j = flatRing.length - 2; i < flatRing.length; j = i, i += 2) {
      const yi = flatRing[i + 1], yj = flatRing[j + 1];
      if (yi > y !== yj > y && x < ((flatRing[j] - flatRing[i]) * (y - yi)) / (yj - yi) + flatRing[i]) odd = !odd;
    }
    return odd;
  }

  function nearRing([x, y], ring, closed, reach) {
    const n = ring.length / 2;
    for (let i = 0; i < (closed || n === 1 ? n : n - 1); i++) {
      const j = (i + 1) % n, ax = ring[2 * i], ay = ring[2 * i + 1], dx = ring[2 * j] - ax, dy = ring[2 * j + 1] - ay;
      const t = Math.min(1, Math.max(0, ((x - ax) * dx + (y - ay) * dy) / (dx * dx + dy * dy || 1)));
      if (Math.hypot(x - ax - t * dx, y - ay - t * dy) <= reach) return true;
    }
    return false;
  }

  function bodyAt(name, at) { // the number of a body of the robot there, or -1
    if (!stage.scene[name]) return -1;
    return stage.kinematics.place(doc[name]).findIndex(({ points, closed }) =>
      (closed && inside(at, points)) || nearRing(at, [...points], closed, near * pixel()));
  }

  /** What a press at a place takes hold of: {select, drag(from, to, original)}; null for nothing. */
  function grip(at) {
    const reach = near * pixel();
    for (const name of ["goal", "start"]) {
      const handle = turnHandle(name);
      if (handle && apart(handle.at, at) <= reach) return { select: { kind: name }, drag: (from, to, pose) => turnTo(pose, handle, from, to) };
    }
    for (const name of ["goal", "start"]) {
      const body = bodyAt(name, at);
      if (body < 0) continue;
      if (moves()) return { select: { kind: name }, drag: (from, to, pose) => movePose(pose, from, to) };
      let joint = view.robot.bodies[body].joint;
      while (joint >= 0 && view.robot.joints[joint].kind !== "turn") joint = view.robot.joints[joint].parent;
      if (joint < 0) return { select: { kind: name }, drag: () => {} };
      const handle = { joint, centre: frameOf(name, joint) };
      return { select: { kind: name }, drag: (from, to, pose) => turnTo(pose, handle, from, to) };
    }
    if (selected && selected.kind === "obstacle") {
      for (const [r, ring] of rings(doc.obstacles[selected.index]).entries()) {
        const corner = ring.findIndex((point) => apart(point, at) <= reach);
        if (corner >= 0) return { select: selected, drag: (from, to, part) => { rings(part)[r][corner] = to.map(tidy); } };
      }
    }
    for (let index = doc.obstacles.length - 1; index >= 0; index--) {
      const part = doc.obstacles[index];
      if (rings(part).filter((ring) => inside(at, flat(ring))).length % 2) return { select: { kind: "obstacle", index }, drag: movePart };
    }
    return null;
  }

  function movePose(pose, from, to) {
    for (const [i, kind] of ["x", "y"].entries()) { const c = coordinate(jointOf(kind)); pose[c] = tidy(pose[c] + to[i] - from[i]); }
  }

  function turnTo(pose, { joint, centre }, from, to) {
    const c = coordinate(joint), angle = ([x, y]) => Math.atan2(y - centre[1], x - centre[0]);
    let value = pose[c] + angle(to) - angle(from);
    value -= 2 * Math.PI * Math.round(value / (2 * Math.PI));
    pose[c] = (Math.round((value * 180) / Math.PI) * Math.PI) / 180; // whole degrees
  }

  function movePart(from, to, part) {
    const [dx, dy] = [to[0] - from[0], to[1] - from[1]];
    for (const ring of rings(part)) for (const point of ring) { point[0] = tidy(point[0] + dx); point[1] = tidy(point[1] + dy); }
  }

  const valueOf = (what) => (what.kind === "obstacle" ? doc.obstacles[what.index] : doc[what.kind]);
  function put(what, value) { if (what.kind === "obstacle") doc.obstacles[what.index] = value; else doc[what.kind] = value; }

  /** Follow a pointer from its press to its release. */
  function follow(event, move, end) {
    const id = event.pointerId, at = (e) => stage.toWorld(e.clientX, e.clientY);
    canvas.setPointerCapture(id);
    const moved = (e) => { if (e.pointerId === id) move(at(e)); };
    const ended = (e) => {
      if (e.pointerId !== id) return;
      canvas.removeEventListener("pointermove", moved);
      for (const name of ["pointerup", "pointercancel"]) canvas.removeEventListener(name, ended);
      end(at(e), e.type === "pointercancel");
    };
    canvas.addEventListener("pointermove", moved);
    for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, ended);
  }

  stage.onpress = (at, event) => {
    if (!doc || !view.robot || event.button > 0) return false;
    canvas.focus({ preventScroll: true });
    near = event.pointerType === "touch" ? NEAR_FINGER : NEAR;
    if (tool === "box") {
      drawn = [at, at];
      follow(event, (to) => { drawn = [at, to]; stage.draw(); }, (to, cancelled) => {
        const ring = boxRing([at, to]).map((point) => point.map(tidy)), size = [ring[2][0] - ring[0][0], ring[2][1] - ring[0][1]];
        drawn = null;
        if (!cancelled && Math.min(...size) > 3 * pixel()) add(ring); else stage.draw();
      });
      return true;
    }
    if (tool === "polygon") {
      if (drawn && drawn.length > 2 && apart(drawn[0], at) <= near * pixel()) close();
      else { drawn = [...(drawn || []), at.map(tidy)]; stage.draw(); }
      return true;
    }
    const held = grip(at);
    select(held && held.select);
    if (!held) return false;
    const before = JSON.stringify(doc), original = copy(valueOf(held.select));
    follow(event, (to) => {
      const value = copy(original);
      held.drag(at, to, value);
      put(held.select, value);
      fill();
      redraw();
    }, () => settle(before));
    return true;
  };
  // A second press of a double click draws; it does not zoom.
  canvas.addEventListener("dblclick", (event) => { if (tool !== "move") event.stopImmediatePropagation(); }, true);

  function add(polygon) {
    change(() => { doc.obstacles.push({ polygon, holes: [] }); selected = { kind: "obstacle", index: doc.obstacles.length - 1 }; });
    use("move");
  }

  function close() {
    const ring = drawn;
    drawn = null;
    if (ring && ring.length > 2) add(ring); else stage.draw();
  }

  function select(what) {
    selected = what || null;
    buttons.remove.disabled = !(selected && selected.kind === "obstacle");
    redraw();
  }

  function use(name) {
    tool = name;
    drawn = null;
    for (const [other] of TOOLS) buttons[other].setAttribute("aria-pressed", String(other === name));
    $("hint").textContent = TOOLS.find(([other]) => other === name)[3];
    canvas.classList.toggle("draws", name !== "move");
    if (view.robot) stage.draw();
  }

  function remove() {
    if (!selected || selected.kind !== "obstacle") return;
    change(() => { doc.obstacles.splice(selected.index, 1); selected = null; });
    select(null);
  }

  /** Select the next thing, for those who use keys. */
  function next(by) {
    const all = [{ kind: "start" }, { kind: "goal" }, ...doc.obstacles.map((_, index) => ({ kind: "obstacle", index }))];
    const at = all.findIndex((one) => selected && one.kind === selected.kind && one.index === selected.index);
    select(all[(at + by + all.length) % all.length]);
  }

  function nudge(dx, dy) {
    const step = Math.max(doc.bounds[2] - doc.bounds[0], doc.bounds[3] - doc.bounds[1]) / 100;
    change(() => {
      const value = copy(valueOf(selected)), to = [dx * step, dy * step];
      if (selected.kind === "obstacle") movePart([0, 0], to, value); else if (moves()) movePose(value, [0, 0], to);
      put(selected, value);
    });
  }

  function turn(by) {
    const joint = jointOf("turn");
    if (!selected || selected.kind === "obstacle" || joint < 0) return;
    change(() => { doc[selected.kind][coordinate(joint)] = Math.atan2(Math.sin(doc[selected.kind][coordinate(joint)] + by), Math.cos(doc[selected.kind][coordinate(joint)] + by)); });
  }

  canvas.addEventListener("keydown", (event) => {
    if (!doc || !view.robot) return;
    const arrows = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }[event.key], fine = event.shiftKey ? 0.1 : 1;
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const act = {
      Delete: remove, Backspace: remove, Enter: () => (tool === "polygon" ? close() : tool === "box" ? addInTheMiddle() : next(1)),
      Escape: () => { use("move"); select(null); }, n: () => next(1), N: () => next(-1),
      "[": () => turn((Math.PI / 36) * fine), "]": () => turn((-Math.PI / 36) * fine),
      "+": () => stage.zoom(1.4), "=": () => stage.zoom(1.4), "-": () => stage.zoom(1 / 1.4), 0: () => stage.fit(),
    }[event.key] || (arrows && selected && (() => nudge(arrows[0] * fine, arrows[1] * fine)))
      || (TOOLS.some(([, , key]) => key === event.key) && (() => use(TOOLS.find(([, , key]) => key === event.key)[0])));
    if (!act) return;
    event.preventDefault();
    act();
  });
  document.addEventListener("keydown", (event) => {
    if (!(event.ctrlKey || event.metaKey) || event.target.matches("input[type=text], input[type=number]")) return;
    const key = event.key.toLowerCase();
    if (key === "z" && !event.shiftKey) { event.preventDefault(); travel(done, undone); }
    else if (key === "y" || (key === "z" && event.shiftKey)) { event.preventDefault(); travel(undone, done); }
  });

  function addInTheMiddle() {
    const [x, y] = stage.view.centre, side = Math.min(doc.bounds[2] - doc.bounds[0], doc.bounds[3] - doc.bounds[1]) / 20;
    add(boxRing([[x - side, y - side], [x + side, y + side]]).map((point) => point.map(tidy)));
  }

  const buttons = {};
  function toolbar() {
    const bar = document.querySelector(".tools"), button = (name, text, act, extra = {}) => {
      buttons[name] = make("button", { type: "button", text, click: act, ...extra });
      bar.append(buttons[name]);
    };
    for (const [name, text, key] of TOOLS) button(name, text, () => use(name), { title: `${text} (${key.toUpperCase()})`, "aria-pressed": "false" });
    button("remove", "Remove", remove, { title: "Remove the selected obstacle (Delete)", disabled: true });
    button("undo", "Undo", () => travel(done, undone), { title: "Undo (Ctrl Z)" });
    button("redo", "Redo", () => travel(undone, done), { title: "Redo (Ctrl Y)" });
    button("clear", "Clear", () => change(() => { doc.obstacles = []; doc.regions = {}; }), { title: "Remove all obstacles" });
    button("whole", "Whole", () => stage.fit(), { title: "Show the whole workspace (0)" });
  }

  // Settings ---------------------------------------------------------------------------------------------

  const number = (label, value, act, more = {}) => make("label", {}, label, make("input", { type: "number", step: "any", value,
    change: (event) => { const v = Number(event.target.value); if (event.target.value !== "" && Number.isFinite(v)) act(v); else fill(true); }, ...more }));

  let filled = "";
  /** The settings as the document has them; not while somebody types in them. */
  function fill(force = false) {
    const key = JSON.stringify([doc.robot, doc.start, doc.goal, doc.bounds, view.robot && view.robot.joints]);
    if (key === filled && !force) return;
    filled = key;
    const at = document.activeElement, label = at && at.closest && at.closest(".settings fieldset") ? at.getAttribute("aria-label") : null;
    fillRobot();
    fillPoses();
    const again = label && document.querySelector(`.settings [aria-label="${CSS.escape(label)}"]`);
    if (again) again.focus();
  }

  let ownShape = null;
  function fillRobot() {
    const robot = doc.robot || {}, known = robot.kind in ROBOTS && !(robot.kind === "polygon" && robot.name !== "L shape");
    if (!known) ownShape = copy(robot);
    const kinds = make("select", { "aria-label": "Kind of robot", change: () => change(() => { doc.robot = robotOf(kinds.value); }) },
      ...Object.entries(ROBOTS).map(([kind, text]) => make("option", { value: kind, text })));
    if (ownShape) kinds.append(make("option", { value: "own", text: ownShape.name || "its own shape" }));
    kinds.value = known ? robot.kind : "own";
    const sizes = ["length", "width"].filter((name) => Number.isFinite(robot[name])).map((name) =>
      number(name, robot[name], (v) => change(() => { doc.robot = { ...robot, [name]: v, name: undefined }; }), { min: 0, "aria-label": `robot's ${name}` }));
    const [xmin, ymin, xmax, ymax] = doc.bounds;
    const sides = [["width", xmax - xmin, 2], ["height", ymax - ymin, 3]].map(([name, value, i]) =>
      number(`room's ${name}`, Number(value.toPrecision(9)), (v) => { if (v > 0) change(() => { doc.bounds[i] = doc.bounds[i - 2] + v; }); }, { min: 0, "aria-label": `room's ${name}` }));
    $("robot").replaceChildren(make("legend", { text: "Robot and room" }), kinds, ...sizes, ...sides);
  }

  function robotOf(kind) {
    const side = Math.min(doc.bounds[2] - doc.bounds[0], doc.bounds[3] - doc.bounds[1]) * 0.08, { length = tidy(side), width = tidy(side * 0.4) } = doc.robot || {};
    if (kind === "own") return ownShape;
    if (kind === "point") return { kind };
    if (kind === "segment") return { kind, length };
    if (kind === "rectangle") return { kind, length, width };
    const a = length / 2, b = width;
    return { kind, name: "L shape", corners: [[-a, -a], [a, -a], [a, b - a], [b - a, b - a], [b - a, a], [-a, a]] };
  }

  function fillPoses() {
    const rows = ["start", "goal"].map((name) => {
      const inputs = doc[name].map((value, i) => {
        const joint = view.robot && view.robot.joints.find((one) => one.coordinate === i), turns = joint ? joint.kind === "turn" : i > 1;
        const label = turns ? (doc[name].length > 3 || !moves() ? `${i + 1}, °` : "turn, °") : "xy"[i] || `${i + 1}`;
        return number(label, turns ? degrees(value) : Number(value.toPrecision(9)), (v) => change(() => { doc[name][i] = turns ? (v * Math.PI) / 180 : v; }),
          { "aria-label": `${name} ${label}` });
      });
      return make("div", { class: "pose" }, make("b", { text: name }), ...inputs);
    });
    $("poses").replaceChildren(make("legend", { text: "Start and goal" }), ...rows);
  }

  let chosen = ["rrt", "hybrid"];
  function fillGuidances(typed = ($("guidances").querySelector("input") || { value: "" }).value) {
    const list = make("ul", {}, ...chosen.map((name, i) => make("li", {}, make("span", { text: name }),
      make("button", { type: "button", "aria-label": `Leave out ${name}`, title: "Leave out", text: "×", click: () => { chosen.splice(i, 1); fillGuidances(); } }))));
    const input = make("input", { type: "text", list: "known", maxlength: 500, spellcheck: "false", autocomplete: "off",
      "aria-label": "A guidance or an expression", placeholder: "lazy_prm, roadmap(robot=disc), …", value: typed,
      keydown: (event) => { if (event.key === "Enter") include(); } });
    const include = () => {
      const text = input.value.trim();
      if (!text) return;
      if (chosen.length >= MOST_GUIDANCES) return say(`Up to ${MOST_GUIDANCES} guidances run at once: leave one out first.`, true);
      if (!chosen.includes(text)) chosen.push(text);
      fillGuidances("");
      $("guidances").querySelector("input").focus();
    };
    $("guidances").replaceChildren(make("legend", { text: "Guidances" }), list,
      make("div", { class: "add" }, input, make("button", { type: "button", text: "Add", click: include })),
      make("datalist", { id: "known" }, ...about.guidances.map((value) => make("option", { value }))));
  }

  // Files ------------------------------------------------------------------------------------------------

  function fillFiles() {
    const group = (label, entries) => {
      const element = make("optgroup", { label });
      element.append(...entries.map(([value, text]) => make("option", { value, text })));
      return element;
    };
    const files = about.files.length ? [group("In the folder", about.files.map((name) => [`f:${name}`, name]))] : [];
    $("open").replaceChildren(make("option", { value: "", text: "a problem …" }), make("option", { value: "new", text: "an empty room" }), ...files,
      group("Examples", Object.entries(about.examples).map(([name, fixed]) => [`e:${name}`, fixed ? name : `${name} (a new one)`])));
  }

  async function open(request, name) {
    try {
      const { document: found } = await ask("open", request);
      take(found, name);
      say(`Opened ${name}.`);
    } catch (error) { say(error.message, true); }
  }

  const fileName = (text) => `${text.replace(/[^\p{L}\p{N} _.()+-]/gu, "-").replace(/^[^\p{L}\p{N}]+/u, "") || "problem"}.toml`;
  const EMPTY = { format: "guided-gym problem 1", name: "Room", bounds: [0, 0, 10, 10], start: [1, 5, 0], goal: [9, 5, 0],
    robot: { kind: "rectangle", length: 0.8, width: 0.3 }, obstacles: [] };

  $("open").addEventListener("change", () => {
    const value = $("open").value, name = value.slice(2);
    $("open").value = "";
    if (value === "new") { take(copy(EMPTY), "Room.toml"); say("An empty room. Draw obstacles, then search."); }
    else if (value.startsWith("f:")) open({ name }, name);
    else if (value.startsWith("e:")) open({ example: name, seed: about.examples[name] ? 0 : Math.floor(Math.random() * 1e6) }, fileName(name));
  });
  $("upload").addEventListener("change", async () => {
    const [file] = $("upload").files;
    $("upload").value = "";
    if (!file) return;
    if (file.size > 2 ** 23) return say(`${file.name} is too large for the lab: at most 8 MiB.`, true);
    open({ name: file.name, text: await file.text() }, file.name);
  });
  $("upload-label").addEventListener("keydown", (event) => { if (event.key === "Enter" || event.key === " ") { event.preventDefault(); $("upload").click(); } });

  async function save(replace = false) {
    let name = $("name").value.trim();
    if (!/\.(toml|json)$/.test(name)) name = fileName(name);
    $("name").value = name;
    doc.name = name.replace(/\.(toml|json)$/, "");
    try {
      const answer = await ask("save", { name, document: doc, replace });
      if (answer.exists) {
        return say(`There is a file ${name} already.`, true, make("button", { type: "button", text: "Replace it", click: () => save(true) }));
      }
      about.files = answer.files;
      fillFiles();
      keep();
      say(`Saved as ${name} in ${about.folder}.`);
    } catch (error) { say(error.message, true); }
  }
  $("save").addEventListener("click", () => save());

  // Searches ---------------------------------------------------------------------------------------------

  let runs = [], shown = [], player = null;

  class Run {
    constructor(guidance, seed, samples) {
      Object.assign(this, { guidance, seed, samples, trace: null, facts: null, error: null, running: true, cancelled: false });
      this.stop = new AbortController();
      this.read(copy(doc));
    }

    async read(document_) {
      try {
        const response = await fetch("api/run", { method: "POST", headers: { "Content-Type": "application/json" }, signal: this.stop.signal,
          body: JSON.stringify({ document: document_, guidance: this.guidance, seed: this.seed, samples: this.samples }) });
        if (!response.ok) throw new Error((await response.json()).error);
        const reader = response.body.pipeThrough(new TextDecoderStream()).getReader();
        let rest = "";
        for (;;) {
          const { done: ended, value } = await reader.read();
          const lines = (rest + (value || "")).split("\n");
          rest = ended ? "" : lines.pop();
          for (const line of lines) if (line) this.take(line);
          news(this);
          if (ended) break;
        }
        if (!this.facts && !this.error) this.error = "the search ended early";
      } catch (error) {
        this.error = this.cancelled ? null : error.name === "TypeError" ? "The lab's server does not answer; is it still running?" : error.message;
      }
      this.running = false;
      news(this);
    }

    take(line) {
      let row;
      try { row = JSON.parse(line); } catch { return; } // a line that broke off
      if (row.error) this.error = row.error;
      else if (row.facts) this.facts = row.facts;
      else if (row.format) {
        this.trace = new G.Trace(row);
        this.trace.header.title = this.guidance;
      } else this.trace.push(row);
    }

    cancel() { this.cancelled = true; this.stop.abort(); }

    get outcome() {
      const drawnSoFar = this.trace ? this.trace.samples : 0;
      if (this.error) return this.error;
      if (this.cancelled) return `cancelled after ${drawnSoFar} samples`;
      if (this.running) return drawnSoFar ? `searching: ${drawnSoFar} samples` : "getting ready … (kernels of a first search compile for up to a minute)";
      return this.facts.solved ? "solved" : `not solved in ${this.facts.samples} samples`;
    }
  }

  let due = false;
  function news(run) {
    if (run.trace && shown.includes(run) && (!player || !player.traces.includes(run.trace))) show();
    if (due) return;
    due = true;
    requestAnimationFrame(() => {
      due = false;
      fillResults();
      if (player) { player.grew(); goOn(); }
    });
  }

  /** Play on while samples arrive. */
  function goOn() {
    const open_ = shown.some((run) => run.running);
    if (player.live && !player.playing && player.sample < player.length) player.play();
    if (!open_) player.live = false;
  }

  function show() {
    const traces = shown.filter((run) => run.trace).map((run) => run.trace);
    if (player) { player.pause(); player._resized.disconnect(); }
    player = null;
    $("player").replaceChildren();
    if (!traces.length) return;
    const holder = make("div", {});
    $("player").append(holder);
    player = new G.Player(holder, traces, {});
    player.live = true;
    if (matchMedia("(prefers-reduced-motion: reduce)").matches) { player.live = false; player.seek(player.length); } else player.play();
    window.lab.player = player;
  }

  /** The row of a run in the table. It is made once and then changed, so that its button stays where it is. */
  function rowOf(run) {
    const number_ = (label) => make("td", { class: "number", "data-label": label });
    const box = make("input", { type: "checkbox", "aria-label": `Show ${run.guidance}`, change: () => {
      if (box.checked) shown = [...shown, run].slice(-2); else shown = shown.filter((one) => one !== run);
      show(); fillResults();
    } });
    const cells = { box, what: make("td", {}), samples: number_("samples"), total: number_("total SE"), path: number_("path"), seconds: number_("seconds"),
      stop: make("button", { type: "button", text: "Cancel", "aria-label": `Cancel ${run.guidance}`, click: () => run.cancel() }) };
    const row = make("tr", {}, make("td", {}, box), make("td", { text: run.guidance }), cells.what, cells.samples, cells.total, cells.path,
      cells.seconds, make("td", {}, cells.stop));
    return { row, cells };
  }

  function fillResults() {
    $("results").hidden = !runs.length;
    for (const run of runs) {
      run.shown = run.shown || rowOf(run);
      const { cells } = run.shown, facts = run.facts;
      cells.box.checked = shown.includes(run);
      cells.box.disabled = !run.trace;
      cells.what.className = run.error ? "what bad" : facts && facts.solved ? "what good" : "what";
      cells.what.textContent = run.outcome;
      cells.samples.textContent = run.trace ? String(run.trace.samples) : "";
      cells.total.textContent = facts ? G.digits(facts.total) : "";
      cells.path.textContent = facts && facts.length !== null ? G.digits(facts.length, 4) : "";
      cells.seconds.textContent = facts ? G.digits(facts.preparation + facts.seconds) : "";
      cells.stop.hidden = !run.running;
    }
    const body = $("results").tBodies[0], rows = runs.map((run) => run.shown.row);
    if (rows.length !== body.rows.length || rows.some((row, i) => body.rows[i] !== row)) body.replaceChildren(...rows);
  }

  $("run").addEventListener("click", () => {
    const seed = Number($("seed").value), samples = Number($("samples").value);
    if (!chosen.length) return say("Add a guidance first.", true);
    const fresh = chosen.map((guidance) => new Run(guidance, seed, samples));
    runs = [...fresh, ...runs].slice(0, MOST_RUNS);
    shown = fresh.slice(0, 2);
    say("");
    if (player) show();
    fillResults();
  });

  // The page ---------------------------------------------------------------------------------------------

  new ResizeObserver(() => { if (doc && view.robot) requestAnimationFrame(() => stage.draw()); }).observe(canvas);
  window.lab = { stage, get document() { return doc; }, get ready() { return !!view.robot; }, get runs() { return runs; }, player: null, select, turnHandle };
  (async () => {
    try { about = await ask("start"); } catch (error) { return say(error.message, true); }
    toolbar();
    document.querySelector(".top").append(G.themeButton((theme) => { stage.theme = theme; if (view.robot) stage.draw(); if (player) player.setTheme(theme); }));
    fillFiles();
    fillGuidances();
    $("samples").max = about.limits.samples;
    use("move");
    const before = about.first.name ? null : kept();
    if (before) { take(before.doc, before.name); say("This is what you drew last; it was kept in this browser."); }
    else if (about.first.name) await open({ name: about.first.name }, about.first.name);
    else await open(about.first, fileName(about.first.example));
    if (!doc) take(copy(EMPTY), "Room.toml");
  })();
})();
