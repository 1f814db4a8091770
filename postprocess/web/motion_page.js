// The page: playback, mouse, touch and keys. `vgmpi` is the interface for scripts.
"use strict";

const vgmpi = { ready: null };

async function start() {
  const find = (id) => document.getElementById(id);
  const canvas = find("view"), slider = find("time"), button = find("play");
  const motion = new Motion(await payload());
  find("gaussians").remove(); // the bytes are read: free the text
  await motion.load();
  const view = motion.header.view, frames = motion.frames;
  const camera = new Camera(view.camera);
  const renderer = new Renderer(canvas, motion);
  let shown = -1, queue = Promise.resolve(), playing = null, dirty = true, busy = false;

  const show = (index) => {
    queue = queue.then(async () => {
      await motion.seek(index);
      renderer.update();
      shown = index;
      slider.value = index;
      find("clock").textContent = `${frames[index].time.toFixed(3)} s`;
      paint();
    });
    return queue;
  };
  const paint = () => {
    const ratio = vgmpi.ratio ?? devicePixelRatio;
    const width = Math.max(1, Math.round(canvas.clientWidth * ratio));
    renderer.resize(width, Math.max(1, Math.round(canvas.clientHeight * ratio)));
    renderer.draw(camera, view);
    dirty = false;
  };
  const play = (on) => {
    playing = on ? { since: performance.now(), first: shown === frames.length - 1 ? 0 : shown } : null;
    button.classList.toggle("playing", on);
  };
  const jump = (index) => {
    play(false);
    return show(Math.max(0, Math.min(frames.length - 1, index)));
  };
  const tick = (now) => {
    if (playing && !busy) {
      const count = Math.floor((now - playing.since) / 1000 * view.fps);
      const index = (playing.first + Math.max(count, 0)) % frames.length;
      if (index !== shown) {
        busy = true;
        show(index).finally(() => { busy = false; });
        dirty = false;
      }
    }
    if (dirty && !busy && shown >= 0) paint();
    requestAnimationFrame(tick);
  };

  slider.max = frames.length - 1;
  slider.oninput = () => jump(Number(slider.value));
  button.onclick = () => play(!playing);
  const actions = {
    " ": () => play(!playing),
    ArrowRight: () => jump(shown + 1),
    ArrowLeft: () => jump(shown - 1),
    Home: () => jump(0),
    End: () => jump(frames.length - 1),
    r: () => { camera.set(view.camera); dirty = true; },
    f: () => document.documentElement.requestFullscreen?.(),
  };
  addEventListener("keydown", (event) => {
    if (!actions[event.key] || event.ctrlKey || event.metaKey) return;
    event.preventDefault();
    actions[event.key]();
  });
  const touches = new Map();
  canvas.onpointerdown = (event) => {
    canvas.setPointerCapture(event.pointerId);
    touches.set(event.pointerId, [event.clientX, event.clientY]);
  };
  canvas.onpointerup = canvas.onpointercancel = (event) => touches.delete(event.pointerId);
  canvas.onpointermove = (event) => {
    const before = touches.get(event.pointerId);
    if (!before) return;
    const now = [event.clientX, event.clientY];
    const [dx, dy] = add(now, before, -1);
    if (touches.size === 2) {
      const other = [...touches].find(([id]) => id !== event.pointerId)[1];
      camera.zoom(Math.hypot(...add(before, other, -1)) / Math.max(1, Math.hypot(...add(now, other, -1))));
      camera.pan(dx / 2, dy / 2, canvas.clientHeight);
    } else if (event.buttons & 2 || event.shiftKey) camera.pan(dx, dy, canvas.clientHeight);
    else camera.orbit(-0.006 * dx, 0.006 * dy);
    touches.set(event.pointerId, now);
    dirty = true;
  };
  canvas.addEventListener("webglcontextlost", () => {
    find("message").textContent = "The graphics card was lost: load the page again.";
    find("message").hidden = false;
    play(false);
  });
  canvas.oncontextmenu = (event) => event.preventDefault();
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    camera.zoom(Math.exp(0.001 * event.deltaY));
    dirty = true;
  }, { passive: false });
  new ResizeObserver(() => { dirty = true; }).observe(canvas);

  Object.assign(vgmpi, {
    motion, camera, renderer,
    show: jump,
    play,
    // Draw from another camera: { eye, target, up, fov }.
    look: (entry) => { camera.set(entry); paint(); },
    // Integers of a group in the frame that is shown, channel by channel.
    bins: (group) => Array.from(motion.groups[group].coder.history[0]),
  });
  await show(0);
  find("count").textContent = `${motion.count.toLocaleString("en")} Gaussians`;
  document.body.classList.add("ready");
  requestAnimationFrame(tick);
  play(true);
}

vgmpi.ready = start().catch((error) => {
  const line = document.getElementById("message");
  line.textContent = error.message;
  line.hidden = false;
  throw error;
});
