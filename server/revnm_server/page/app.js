// The operator's page: live picture, state ten times a second, a click sets the goal, Stop is always there.

import { draw, pixelAt } from "./overlay.js";

const QUIET_MS = 1500; // no word from the server for this long: what is shown is old
const CLICK_PX = 8; // a pointer that moves farther drags, and sets no goal
const STATUS = { no_goal: "No goal", driving: "Driving", arrived: "Arrived", stopped: "Stopped", waiting: "Waiting" };

const $ = (id) => document.getElementById(id);
const canvas = $("overlay");
let state = null;
let heardAt = 0;
let pressed = null;

// The token came with the page and is a cookie now: it need not stay in the address bar.
if (location.search) history.replaceState(null, "", location.pathname);

function chosen() {
  return $("robot").value;
}

function listen() {
  const address = new URL("api/v1/events", location.href);
  address.protocol = location.protocol === "https:" ? "wss:" : "ws:";
  const socket = new WebSocket(address);
  socket.onmessage = (event) => show(JSON.parse(event.data));
  socket.onclose = () => setTimeout(listen, 1000);
}

async function pollWhileQuiet() {
  if (performance.now() - heardAt > QUIET_MS) {
    const answer = await call("GET", "state").catch(() => null);
    if (answer) show(answer);
    else render();
  }
  setTimeout(pollWhileQuiet, 700);
}

function show(next) {
  state = next;
  heardAt = performance.now();
  const names = state.robots.map((robot) => robot.name);
  const select = $("robot");
  if (names.join() !== [...select.options].map((option) => option.value).join()) {
    const keep = select.value;
    select.replaceChildren(...names.map((name) => new Option(name, name)));
    if (names.includes(keep)) select.value = keep;
  }
  render();
}

function render() {
  const quiet = performance.now() - heardAt > QUIET_MS;
  if (!state) {
    badge("no answer from the server", "bad");
    return;
  }
  const running = state.camera.state === "running" && !quiet;
  $("view").classList.toggle("stale", !running);
  if (quiet) badge("server silent", "bad");
  else if (running) badge("live", "good");
  else badge(`picture ${state.camera.state}`, "bad");
  const notice = quiet ? "No word from the server: this is old" : running ? "" : state.camera.reason;
  $("notice").textContent = notice;
  $("notice").hidden = !notice;
  draw(canvas, state, chosen());
  renderRobot(state.robots.find((robot) => robot.name === chosen()));
}

function badge(text, kind) {
  setText("badge", text);
  $("badge").className = `badge ${kind}`;
}

function setText(id, text) {
  if ($(id).textContent !== text) $(id).textContent = text; // screen readers repeat what is set again
}

function renderRobot(robot) {
  if (!robot) return;
  setText("status", STATUS[robot.status]);
  $("status").className = `status ${robot.status}`;
  setText("reason", robot.reason ?? state.reasons.concat(state.warnings).join("; "));
  $("resume").hidden = robot.status !== "stopped";
  $("drop").hidden = robot.goal === null;
  const own = robot.robot_state;
  const { fps, frame_age_s: age } = state.camera;
  const facts = {
    "Picture": age === null ? "none yet" : `${age.toFixed(1)} s old${fps ? `, ${fps.toFixed(0)} fps` : ""}`,
    "Tag seen": robot.sighting_age_s === null ? "never" : `${robot.sighting_age_s.toFixed(1)} s ago`,
    "Robot says": own === null ? "nothing yet" : own.moving ? "moving" : own.reason ?? "standing",
    "Heard": robot.robot_state_age_s === null ? "never" : `${robot.robot_state_age_s.toFixed(1)} s ago`,
    "Tick": state.timings_ms.tick ? `${state.timings_ms.tick.p50.toFixed(0)} ms` : "–",
  };
  $("facts").replaceChildren(
    ...Object.entries(facts).flatMap(([name, value]) => [element("dt", name), element("dd", value)]),
  );
}

function element(tag, text) {
  const made = document.createElement(tag);
  made.textContent = text;
  return made;
}

/** Call the API; throws an Error whose message is for the operator. */
async function call(method, path, body) {
  const options = { method, signal: AbortSignal.timeout(4000) };
  if (body) {
    options.headers = { "Content-Type": "application/json" };
    options.body = JSON.stringify(body);
  }
  const answer = await fetch(`api/v1/${path}`, options);
  if (answer.ok) return answer.status === 204 ? null : answer.json();
  const problem = await answer.json().catch(() => ({}));
  throw new Error(problem.detail ?? problem.title ?? `The server answered ${answer.status}`);
}

async function act(method, path, body) {
  const robot = chosen();
  if (!robot) return;
  try {
    const answer = await call(method, `robots/${encodeURIComponent(robot)}/${path}`, body);
    const silent = answer?.acknowledged === false;
    setText("message", silent ? `${robot} has not confirmed the ${path}: it is told again until it does` : "");
  } catch (error) {
    setText("message", path === "stop" ? `STOP DID NOT GET THROUGH: ${error.message}` : error.message);
  }
}

canvas.addEventListener("pointerdown", (event) => {
  pressed = event.isPrimary && event.button === 0 ? [event.clientX, event.clientY] : null;
});
canvas.addEventListener("pointercancel", () => (pressed = null));
canvas.addEventListener("pointerup", (event) => {
  if (!pressed || !state?.camera.size_px) return;
  const moved = Math.hypot(event.clientX - pressed[0], event.clientY - pressed[1]);
  pressed = null;
  const pixel = moved <= CLICK_PX ? pixelAt(event, canvas, state.camera.size_px) : null;
  if (pixel) act("PUT", "goal", pixel);
});
$("stop").addEventListener("click", () => act("POST", "stop"));
$("resume").addEventListener("click", () => act("POST", "resume"));
$("drop").addEventListener("click", () => act("DELETE", "goal"));
$("robot").addEventListener("change", render);
window.addEventListener("resize", () => state && render());
// Capture, before a focused button takes the space bar for itself.
window.addEventListener("keydown", (event) => {
  if (event.code !== "Space") return;
  event.preventDefault();
  if (!event.repeat) act("POST", "stop");
}, true);
window.addEventListener("keyup", (event) => event.code === "Space" && event.preventDefault(), true);

const picture = $("picture");
const stream = () => (picture.src = `api/v1/stream.mjpg?since=${Date.now()}`);
picture.addEventListener("error", () => setTimeout(stream, 1000));
// A stream that ended shows its last picture without an error: begin anew when the server is back.
let wasQuiet = false;
setInterval(() => {
  const quiet = performance.now() - heardAt > QUIET_MS;
  if (wasQuiet && !quiet) stream();
  wasQuiet = quiet;
}, 500);

stream();
listen();
pollWhileQuiet();
