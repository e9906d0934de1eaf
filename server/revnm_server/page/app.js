// The operator's page: a live picture, the state ten times a second, a click sets the goal, Stop is always there.

import { onFloor, ringInPicture } from "./floor.js";
import { drawOverlay } from "./overlay.js";
import { $, doing, setText, showRobot, showRobots, STATUS } from "./panel.js";
import { GoalPicker } from "./picker.js";
import { Server } from "./server.js";
import { PictureStream } from "./stream.js";

const CAMERA = { init: "no picture", stale: "picture stale", reconnecting: "camera lost", ended: "camera ended" };
const LAYERS = {
  exo: "Live picture of the camera",
  depth: "Depth of the camera’s picture: near is bright, far is dark",
  ego: "What the robot is thought to see ahead: near is bright, far is dark",
  map: "Map of the floor: the camera at the lower edge, free floor bright, what stands on it red",
};
const BEHIND_MS = 1500; // a picture that is so much older than the newest is not live
const SPEAK_EVERY_MS = 1500;

let wanted = null; // name of the robot that was chosen last
let layer = "exo";
let spokenAt = 0;
let due = false; // whether a frame is to be drawn

const server = new Server({ onState: render, onMessage: (text) => setText($("message"), text) });
const stream = new PictureStream($("picture"), () => $("view").classList.contains("stale") && render());
const picker = new GoalPicker($("overlay"), {
  size: () => (server.mayOperate && isAligned() && !pictureTrouble() ? (server.state?.camera.size_px ?? null) : null),
  from: () => {
    const pixel = chosen()?.pixel;
    return pixel ? { u: pixel[0], v: pixel[1] } : null;
  },
  onGoal: setGoal,
  onChange: render,
});

/** The robot that clicks and Stop are for; null before the first state. */
function chosen() {
  const robots = server.state?.robots ?? [];
  return robots.find((robot) => robot.name === wanted) ?? robots[0] ?? null;
}

/** Whether the layer shows the camera's pixels. */
function isAligned() {
  return layer === "exo" || layer === "depth";
}

function floorCamera() {
  return server.state.camera.calibration?.camera ?? null;
}

function setGoal(pixel) {
  const camera = floorCamera();
  if (camera && !onFloor(camera, server.state.camera.size_px, pixel)) {
    setText($("message"), "That place is not on the floor: choose one below the horizon.");
  } else server.act(chosen().name, "PUT", "goal", pixel);
}

function stop({ all = false } = {}) {
  picker.cancel();
  if (!server.state) setText($("message"), "STOP CANNOT BE SENT: nothing was heard of the server yet.");
  for (const robot of server.state?.robots ?? []) if (all || robot === chosen()) server.stop(robot.name);
}

/** Show what is known, once a frame at most: where drawing is slow, what has come meanwhile is passed over. */
function render() {
  if (!due) requestAnimationFrame(draw);
  due = true;
}

function draw() {
  due = false;
  const [state, quiet] = [server.state, server.quiet];
  document.body.classList.toggle("stale", quiet);
  document.body.classList.toggle("watch", !server.mayOperate);
  const [trouble, lack] = [pictureTrouble(), layerLack()];
  $("view").classList.toggle("stale", trouble + lack !== "");
  setText($("notice"), trouble || lack);
  $("notice").classList.toggle("calm", trouble === "");
  $("notice").hidden = trouble + lack === "";
  showBadge(trouble);
  if (!state) return;
  const robot = chosen();
  $("map-layer").hidden = !state.camera.calibration;
  if (state.camera.size_px) $("view").style.setProperty("--shape", state.camera.size_px.join(" / "));
  $("overlay").hidden = !isAligned();
  if (isAligned()) drawOverlay($("overlay"), state, { chosen: robot?.name, quiet, preview: preview() });
  showHint();
  if (!robot) return;
  showRobots(state, { chosen: robot.name, quiet, choose });
  showRobot(robot, state, { quiet, may: server.mayOperate });
  speak(robot);
}

/** Why what is shown must not be taken for what is; empty where it may. */
function pictureTrouble() {
  const camera = server.state?.camera;
  if (server.quiet) return "The server is silent: nothing here is current";
  if (!camera) return "";
  if (camera.state !== "running") return `Camera: ${camera.reason}`;
  const behindMs = camera.frame_stamp_ms - (stream.stampMs ?? NaN);
  if (layerLack()) return "";
  if (behindMs > BEHIND_MS) return `The picture is ${(behindMs / 1000).toFixed(0)} s behind`;
  return stream.stalled ? "No new picture comes" : "";
}

/** Why there is nothing to see of a layer, though all is well; empty where there is. */
function layerLack() {
  const robot = chosen();
  const idle = layer === "ego" && robot && robot.status !== "driving";
  return idle ? `What ${robot.name} would see is imagined while it drives` : stream.trouble;
}

function showBadge(trouble) {
  const camera = server.state?.camera;
  const [text, kind] = server.quiet ? [camera ? "server silent" : "no answer from the server", "bad"]
    : !camera ? ["connecting", ""]
    : camera.state !== "running" ? [CAMERA[camera.state], "bad"]
    : trouble ? ["not live", "bad"] : ["live", "good"];
  setText($("badge"), text);
  $("badge").className = `badge ${kind}`;
}

function preview() {
  if (!picker.target) return null;
  const [camera, size] = [floorCamera(), server.state.camera.size_px];
  const radiusM = Math.hypot(...server.state.robot_size_m) / 2;
  const ring = camera ? ringInPicture(camera, size, picker.target, radiusM) : [];
  return { target: picker.target, ring, allowed: !camera || onFloor(camera, size, picker.target) !== null };
}

function showHint() {
  const keys = picker.target && !picker.pressed;
  const text = !isAligned() ? "Goals are set in the camera’s picture."
    : !picker.target ? ""
    : keys ? "Enter sends the robot here, Esc cancels." : "Release to send the robot here, Esc cancels.";
  setText($("hint"), text);
  $("hint").hidden = text === "";
}

/** Tell screen readers what the robot does when that changes, not when a number in it does. */
function speak(robot) {
  const { kind, reason } = doing(robot, server.state);
  const live = $("badge").textContent === "live" ? "" : ` Picture: ${$("badge").textContent}.`;
  const words = server.quiet ? "No contact to the server." : `${robot.name}: ${STATUS[kind]}. ${reason}${live}`;
  const key = words.replace(/[\d.]+/g, "");
  const now = performance.now();
  if (key === $("spoken").dataset.key || now - spokenAt < SPEAK_EVERY_MS) return;
  spokenAt = now;
  $("spoken").dataset.key = key;
  setText($("spoken"), words);
}

function choose(name) {
  wanted = name;
  picker.cancel();
  setText($("message"), "");
  if (layer === "ego") openStream();
  render();
}

function openStream() {
  const robot = layer === "ego" ? `&robot=${encodeURIComponent(chosen()?.name ?? "")}` : "";
  $("picture").setAttribute("aria-label", LAYERS[layer]);
  stream.open(`api/v1/stream.mjpg?layer=${layer}${robot}`);
}

$("layers").addEventListener("change", (event) => {
  layer = event.target.value;
  picker.cancel();
  openStream();
  render();
});
$("stop").addEventListener("click", () => stop());
$("stop-all").addEventListener("click", () => stop({ all: true }));
$("resume").addEventListener("click", () => server.act(chosen().name, "POST", "resume"));
$("drop").addEventListener("click", () => server.act(chosen().name, "DELETE", "goal"));
window.addEventListener("resize", render);
// Nobody looks at a hidden page: the server then draws nothing for it.
document.addEventListener("visibilitychange", () => (document.hidden ? stream.close() : openStream()));
// Capture, before a focused control takes the space bar for itself.
window.addEventListener("keydown", (event) => {
  if (event.code !== "Space") return;
  event.preventDefault();
  if (!event.repeat) stop({ all: event.shiftKey });
}, true);
window.addEventListener("keyup", (event) => event.code === "Space" && event.preventDefault(), true);
setInterval(() => (server.quiet || stream.stalled) && render(), 250); // nothing else tells of silence

// The token came with the page and is a cookie now: it need not stay in the address bar.
if (location.search) history.replaceState(null, "", location.pathname);
openStream();
server.start();
