// The controls of recorded runs: run, play, pause, speed and time. The server keeps the time.

const element = (id) => document.getElementById(id);

export class Timeline {
  constructor(model, send) {
    this.model = model;
    this.send = send;
    this.bar = element('timeline');
    this.seek = element('seek');
    this.button = element('play');
    this.run = element('run-shown');
    this.button.addEventListener('click', () => this.play(!this.model.playback.is_playing));
    element('speed').addEventListener('change', () => this.play(this.model.playback.is_playing));
    this.seek.addEventListener('input', () => this.to(Number(this.seek.value)));
    this.run.addEventListener('change', () => this.send({ kind: 'choose', run: this.run.value }));
    for (const [id, step] of [['run-before', -1], ['run-after', 1]]) {
      element(id).addEventListener('click', () => {
        const run = this.model.runs[this.model.runs.indexOf(this.model.playback.run) + step];
        if (run !== undefined) this.send({ kind: 'choose', run });
      });
    }
    model.addEventListener('hello', () => this.show());
    model.addEventListener('playback', () => this.state());
    model.addEventListener('frame', () => this.time());
  }

  show() {
    const { playback, runs, role } = this.model;
    this.bar.hidden = !playback;
    if (!playback) return;
    this.run.replaceChildren(...runs.map((name) => new Option(name)));
    element('runs').hidden = runs.length < 2;
    for (const one of [this.seek, ...this.bar.querySelectorAll('button, select')]) one.disabled = role !== 'operator';
    this.state();
  }

  state() {
    const { playback, runs, role } = this.model;
    this.button.textContent = playback.is_playing ? 'Pause' : 'Play';
    this.run.value = this.run.title = playback.run;
    this.seek.max = playback.duration;
    element('speed').value = String(playback.speed);
    const at = runs.indexOf(playback.run);
    element('run-before').disabled = role !== 'operator' || at <= 0;
    element('run-after').disabled = role !== 'operator' || at === runs.length - 1;
  }

  time() {
    const { playback, time } = this.model;
    if (!playback) return;
    if (time + 1e-6 < Number(this.seek.value)) this.model.forgetTrails();
    if (this.seek !== document.activeElement || playback.is_playing) this.seek.value = time;
    element('at').textContent = `${time.toFixed(1)} s of ${playback.duration.toFixed(1)} s`;
  }

  to(time) {
    if (this.model.role !== 'operator') return;
    this.model.forgetTrails();
    this.send({ kind: 'seek', time });
  }

  play(isPlaying) {
    this.send({ kind: 'play', is_playing: isPlaying, speed: Number(element('speed').value) });
    this.model.playback.is_playing = isPlaying;
    this.state();
  }
}
