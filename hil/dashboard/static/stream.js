// Server-sent events by fetch, which unlike EventSource can send the token in a header. Connects again by itself.

const AGAIN_MS = 1000;
const SILENT_MS = 3500; // the server speaks once a second

export class Stream {
  constructor({ onFrame, onLink, onRefused }) {
    this.onFrame = onFrame;
    this.onLink = onLink;
    this.onRefused = onRefused;
    this.heard = performance.now();
    this.waiting = false; // for a token
    this.abort = null;
    setInterval(() => this.watch(), 500);
  }

  get token() {
    return sessionStorage.getItem("hil-token") || "";
  }

  set token(value) {
    sessionStorage.setItem("hil-token", value);
  }

  async run() {
    for (;;) {
      try {
        await this.once();
      } catch {
        // the server has gone, or the network: said by `watch`, tried again below
      }
      if (this.waiting) return;
      this.onLink(false, this.silentMs());
      await new Promise((done) => setTimeout(done, AGAIN_MS));
    }
  }

  async once() {
    this.abort = new AbortController();
    const headers = this.token ? { authorization: `Bearer ${this.token}` } : {};
    const response = await fetch("/api/stream", { headers, signal: this.abort.signal, cache: "no-store" });
    if (response.status === 401) {
      this.waiting = true;
      this.onRefused();
      return;
    }
    if (!response.ok) return;
    const reader = response.body.pipeThrough(new TextDecoderStream()).getReader();
    let text = "";
    for (;;) {
      const { value, done } = await reader.read();
      if (done) return;
      text += value;
      let end;
      while ((end = text.indexOf("\n\n")) >= 0) {
        this.take(text.slice(0, end));
        text = text.slice(end + 2);
      }
    }
  }

  take(event) {
    this.heard = performance.now();
    this.onLink(true, 0);
    if (event.startsWith("data: ")) this.onFrame(JSON.parse(event.slice(6)));
  }

  silentMs() {
    return performance.now() - this.heard;
  }

  // A connection may be dead without anybody being told (a laptop that slept, a cable): drop it and connect anew.
  watch() {
    if (this.waiting || this.silentMs() < SILENT_MS) return;
    this.onLink(false, this.silentMs());
    if (this.silentMs() > 3 * SILENT_MS) this.abort?.abort();
  }

  unlock(token) {
    this.token = token;
    this.waiting = false;
    this.run();
  }
}
