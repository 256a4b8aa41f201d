// The time of a recorded run: play, pause, speed and place. The server keeps the time.

export class Timeline {
  constructor(model, send) {
    this.model = model;
    this.send = send;
    this.isPlaying = true;
    this.bar = document.getElementById('timeline');
    this.seek = document.getElementById('seek');
    this.button = document.getElementById('play');
    this.button.addEventListener('click', () => this.play(!this.isPlaying));
    document.getElementById('speed').addEventListener('change', () => this.play(this.isPlaying));
    this.seek.addEventListener('input', () => {
      this.model.forgetTrails();
      this.send({ kind: 'seek', time: Number(this.seek.value) });
    });
    model.addEventListener('hello', () => {
      this.bar.hidden = model.source !== 'run';
      this.seek.max = model.duration;
    });
    model.addEventListener('frame', () => {
      if (this.bar.hidden) return;
      if (model.time + 1e-6 < Number(this.seek.value) && document.activeElement !== this.seek) model.forgetTrails();
      this.seek.value = model.time;
      document.getElementById('at').textContent = `${model.time.toFixed(1)} s of ${model.duration.toFixed(1)} s`;
    });
  }

  play(isPlaying) {
    this.isPlaying = isPlaying;
    this.button.textContent = isPlaying ? 'Pause' : 'Play';
    this.send({ kind: 'play', is_playing: isPlaying, speed: Number(document.getElementById('speed').value) });
  }
}
