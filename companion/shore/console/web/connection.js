// The page's line to its console: frames in over a WebSocket that is opened again for ever, orders out by POST.

const AGAIN_MS = [250, 500, 1000, 2000];
const SILENT_MS = 4000; // the console speaks every second: longer silence is a line that died without a word
const MOST_WAITING = 1000; // bytes on their way: some places of the sticks
const CLOCK_MS = 10000; // of the frames of so long the least delayed one tells the console's clock
const STOP_ANSWER_MS = 2000; // a stop without an answer for so long is given again: the network may have lost it
const ANSWER_MS = 10000; // the console answers within 1 s, and refuses an order that takes longer than 5 s to come
const REFUSED = "The console refused this page: open the address that `aritra shore` printed.";

export class Connection {
  /** onframe(frame), onorder(given), onconsole(about): what comes in. */
  constructor(handlers) {
    this.handlers = handlers;
    this.open = false;
    this.tries = 0;
    this.since_ms = performance.now();
    this.heard_ms = null;
    this.clocks = []; // [ms, the console's clock minus ours] of the last frames; a delay makes it look slow
    this.ahead_ms = null; // the greatest of them
    this.chosen = null;
    this.connect();
    this.watch = setInterval(() => this.check(), 500);
  }

  connect() {
    clearTimeout(this.timer);
    const scheme = location.protocol === "https:" ? "wss" : "ws";
    const socket = new WebSocket(`${scheme}://${location.host}/ws`);
    this.socket = socket;
    this.begun_ms = performance.now();
    socket.onopen = () => {
      if (socket !== this.socket) return socket.close();
      this.open = true;
      this.clocks = []; // the console may have been started anew
      this.tries = 0;
      this.heard_ms = performance.now();
      if (this.chosen) this.choose(this.chosen);
    };
    socket.onmessage = ({ data }) => socket === this.socket && this.hear(JSON.parse(data));
    socket.onclose = () => socket === this.socket && this.lost();
  }

  hear(message) {
    this.heard_ms = performance.now();
    if (message.type === "samples") {
      this.clocks = this.clocks.filter(([at_ms]) => this.heard_ms - at_ms < CLOCK_MS);
      this.clocks.push([this.heard_ms, message.now_ms - this.heard_ms]);
      this.ahead_ms = Math.max(...this.clocks.map(([, ahead_ms]) => ahead_ms));
      this.handlers.onframe?.(message);
    } else if (message.type === "order") this.handlers.onorder?.(message);
    else if (message.type === "console") this.handlers.onconsole?.(message);
  }

  lost() {
    if (this.open) this.since_ms = this.heard_ms ?? performance.now();
    this.open = false;
    const wait = AGAIN_MS[Math.min(this.tries++, AGAIN_MS.length - 1)];
    this.timer = setTimeout(() => this.connect(), wait);
  }

  check() {
    const opening = this.socket?.readyState === WebSocket.CONNECTING;
    if (!(this.open || opening) || performance.now() - (this.open ? this.heard_ms : this.begun_ms) < SILENT_MS) return;
    const dead = this.socket;
    this.socket = null;
    dead.close();
    this.lost();
  }

  /** Try now, not when the pause is over. */
  hurry() {
    if (!this.open && this.socket?.readyState !== WebSocket.CONNECTING) this.connect();
  }

  /** Show this boat closely. */
  choose(boat) {
    this.chosen = boat;
    if (this.open && this.socket?.readyState === WebSocket.OPEN) this.socket.send(JSON.stringify({ choose: boat }));
  }

  /** Where the sticks are; not sent where what was sent before has not gone: it would come too late. */
  tellSticks(sticks) {
    if (this.open && this.socket?.readyState === WebSocket.OPEN && this.socket.bufferedAmount < MOST_WAITING) this.socket.send(JSON.stringify({ sticks }));
  }

  /** Seconds since the console last spoke. */
  silence_s() {
    return (performance.now() - (this.heard_ms ?? this.since_ms)) / 1000;
  }

  /** The console's clock now [ms], by its last frames; it goes on when the console is silent. */
  console_ms() {
    return (this.ahead_ms ?? 0) + performance.now();
  }

  /** POST one order. What the console made of it; {state: "no_answer", unreachable: true} where that is not known: what was under way may have come there. */
  order(body) {
    return this.give("/order", body);
  }

  /** POST what may move the boat: with the instant, for what the network held up must not move it any more. */
  give(path, body) {
    const given_ms = this.ahead_ms === null ? null : this.console_ms();
    return this.post(path, { ...body, given_ms });
  }

  /** POST a stop to boats: a list of orders, whose answers come over the WebSocket; or as `order` in failure. */
  stop(boats) {
    return this.post("/stop", { boats }, STOP_ANSWER_MS);
  }

  async post(path, body, patience_ms = ANSWER_MS) {
    try {
      const answer = await fetch(path, {
        method: "POST",
        headers: { "Content-Type": "application/json" },
        body: JSON.stringify(body),
        signal: AbortSignal.timeout(patience_ms),
      });
      if (answer.ok) return await answer.json();
      const why = answer.status === 403 ? REFUSED : `The console refused it: ${await answer.text()}`;
      return { type: "order", state: "not_sent", ...body, why };
    } catch {
      return { type: "order", state: "no_answer", ...body, tries: 1, why: "The console program does not answer this page.", unreachable: true };
    }
  }
}
