// Talks with the server: hears its state, calls its API, and insists on a Stop until it has got through.

const QUIET_MS = 1500; // no word from the server for this long: what is shown is old
const DEAD_MS = 4000; // a connection that is silent for this long is given up, though it does not say that it has ended
const CONNECT_AGAIN_MS = 1000;
const POLL_MS = 700;
const STOP_AGAIN_MS = 500;
const CALL_MS = 4000;

export class Server {
  /** The last state that was heard, as `/api/v1/state` describes it; null before the first. */
  state = null;
  /** Whether goals may be set and stops released; who only watches may stop. */
  mayOperate = true;
  #heardAt = performance.now();
  #socket = null;
  #openedAt = 0;
  #unheardStops = new Map(); // robots whose Stop has not got through, and how often it was pressed
  #onState;
  #onMessage;

  /** `onState()` is called whenever `state` is new, `onMessage(text)` with what the operator must know of a call. */
  constructor({ onState, onMessage }) {
    this.#onState = onState;
    this.#onMessage = onMessage;
  }

  /** Whether the server has been silent for so long that what is shown is old. */
  get quiet() {
    return performance.now() - this.#heardAt > QUIET_MS;
  }

  start() {
    this.#listen();
    this.#pollWhileQuiet();
  }

  /** Do something with a robot: what goes wrong is told in words. */
  async act(robot, method, path, body) {
    if (path === "resume") this.#unheardStops.delete(robot);
    try {
      await this.#tell(robot, method, path, body);
    } catch (error) {
      this.#onMessage(error.message);
    }
  }

  /** Stop a robot at once, however often it is asked; where the server cannot be reached, again until it can. */
  stop(robot) {
    const turn = (this.#unheardStops.get(robot) ?? 0) + 1;
    this.#unheardStops.set(robot, turn);
    this.#insistOnStop(robot, turn);
  }

  /** Only the last press insists: an earlier one may hang in a connection that is dead. */
  async #insistOnStop(robot, turn) {
    if (this.#unheardStops.get(robot) !== turn) return;
    try {
      await this.#tell(robot, "POST", "stop");
      this.#unheardStops.delete(robot);
    } catch (error) {
      if (this.#unheardStops.get(robot) !== turn) return;
      const refused = error.status >= 400 && error.status < 500;
      const again = refused ? "" : ". It is sent again until it does.";
      this.#onMessage(`STOP HAS NOT GOT THROUGH: ${error.message}${again}`);
      if (refused) this.#unheardStops.delete(robot);
      else setTimeout(() => this.#insistOnStop(robot, turn), STOP_AGAIN_MS);
    }
  }

  async #tell(robot, method, path, body) {
    await call(method, `robots/${encodeURIComponent(robot)}/${path}`, body);
    this.#onMessage(""); // whether the robot has confirmed it stands in the state
  }

  #listen() {
    const address = new URL("api/v1/events", location.href);
    address.protocol = location.protocol === "https:" ? "wss:" : "ws:";
    const socket = new WebSocket(address);
    this.#socket = socket;
    this.#openedAt = performance.now();
    socket.onopen = () => this.#askRole();
    socket.onmessage = (event) => socket === this.#socket && this.#hear(JSON.parse(event.data));
    socket.onclose = () => setTimeout(() => socket === this.#socket && this.#listen(), CONNECT_AGAIN_MS);
  }

  async #askRole() {
    const session = await call("GET", "session").catch(() => null);
    if (session) this.mayOperate = session.role === "operator";
    this.#onState();
  }

  async #pollWhileQuiet() {
    if (this.quiet) {
      const answer = await call("GET", "state").catch(() => null);
      if (answer) this.#hear(answer);
      if (performance.now() - this.#openedAt > DEAD_MS) {
        this.#socket.close();
        this.#listen();
      }
    }
    setTimeout(() => this.#pollWhileQuiet(), POLL_MS);
  }

  #hear(state) {
    this.state = state;
    this.#heardAt = performance.now();
    this.#onState();
  }
}

/** Call the API; throws an Error whose message is for the operator, with the `status` of a refusal. */
async function call(method, path, body) {
  const options = { method, signal: AbortSignal.timeout(CALL_MS) };
  if (body) {
    options.headers = { "Content-Type": "application/json" };
    options.body = JSON.stringify(body);
  }
  const answer = await fetch(`api/v1/${path}`, options).catch((error) => {
    throw new Error(error.name === "TimeoutError" ? "the server does not answer" : "the server cannot be reached");
  });
  if (answer.ok) return answer.status === 204 ? null : answer.json();
  const problem = await answer.json().catch(() => ({}));
  const words = problem.detail ?? problem.title ?? `the server answered ${answer.status}`;
  throw Object.assign(new Error(words), { status: answer.status });
}
