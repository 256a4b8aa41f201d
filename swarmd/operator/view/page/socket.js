// The WebSocket to the server: reconnects by itself, and acknowledges frames, by which the server sets their rate.

const RETRY = [500, 1000, 2000, 5000]; // ms
const WRONG_TOKEN = 4401, ENDED = 4410; // the server's codes, with a reason to show
const SILENCE = 4000; // ms without any message after which the link counts as lost

export class Link {
  constructor(model, on) {
    this.model = model;
    this.on = on;
    this.tries = 0;
    this.heard = 0;
    this.reason = '';
    this.token = ownToken();
    this.open();
    setInterval(() => this.watch(), 500);
  }

  open() {
    const scheme = location.protocol === 'https:' ? 'wss' : 'ws';
    const socket = new WebSocket(`${scheme}://${location.host}/socket?token=${encodeURIComponent(this.token)}`);
    socket.binaryType = 'arraybuffer';
    this.socket = socket;
    socket.onopen = () => { this.heard = performance.now(); };
    socket.onmessage = (event) => { if (socket === this.socket) this.take(event.data); };
    socket.onclose = (event) => { if (socket === this.socket) this.lost(event.code, event.reason); };
  }

  take(data) {
    const now = this.heard = performance.now();
    if (!this.model.isConnected) {
      this.model.isConnected = true;
      this.tries = 0;
      this.reason = '';
      this.on.connected();
    }
    if (typeof data === 'string') {
      const message = JSON.parse(data);
      this.on.message(message, now);
      return;
    }
    const view = new DataView(data);
    const kind = view.getUint32(0, true);
    if (kind === 1) {
      this.model.frame(view, now);
      this.send({ kind: 'ack', sequence: view.getUint32(4, true) });
    } else if (kind === 2) this.model.scan(view);
  }

  watch() {
    if (this.model.isConnected && performance.now() - this.heard > SILENCE) {
      this.socket.close();
      this.lost(0, '');
    }
  }

  lost(code, reason) {
    this.socket.onclose = null;
    this.model.isConnected = false;
    this.model.sequence = 0; // commands need a frame of the next link
    if (code === WRONG_TOKEN || code === ENDED) this.reason = reason;
    this.on.lost(this.reason);
    this.model.tell('rows');
    if (code === WRONG_TOKEN) return; // a wrong token stays wrong
    const wait = RETRY[Math.min(this.tries, RETRY.length - 1)];
    this.tries += 1;
    setTimeout(() => this.open(), wait);
  }

  // False without a link: the message is not sent later.
  send(message) {
    if (this.socket.readyState !== WebSocket.OPEN || !this.model.isConnected) return false;
    this.socket.send(JSON.stringify(message));
    return true;
  }
}

// Remove the token from the address, which a projector may show; this tab keeps it.
function ownToken() {
  const query = new URLSearchParams(location.search);
  try {
    if (query.has('token')) {
      sessionStorage.setItem('token', query.get('token'));
      history.replaceState(null, '', location.pathname);
    }
    return sessionStorage.getItem('token') || '';
  } catch { return query.get('token') || ''; }
}
