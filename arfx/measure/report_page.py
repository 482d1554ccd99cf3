"""The frame of report.html: style and the before/after slider. @TITLE@ and @BODY@ are filled in, already escaped."""

from arfx.run.place import PAGE_START

PAGE = (
    PAGE_START
    + """
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>@TITLE@</title>
<style>
:root { color-scheme: light dark; --ground: #fff; --card: #f6f8fa; --ink: #1f2328; --soft: #59636e;
  --line: #d1d9e0; --warn: #9a6700; }
@media (prefers-color-scheme: dark) {
  :root { --ground: #0d1117; --card: #151b23; --ink: #e6edf3; --soft: #9198a1; --line: #3d444d; --warn: #d29922; } }
* { box-sizing: border-box; }
body { margin: 0 auto; padding: 20px; max-width: 1080px; background: var(--ground); color: var(--ink);
  font: 15px/1.5 system-ui, "Segoe UI", "DejaVu Sans", sans-serif; }
h1 { font-size: 24px; margin: 0; overflow-wrap: anywhere; } h2 { font-size: 17px; margin: 32px 0 10px; }
.path { color: var(--soft); margin: 2px 0 14px; overflow-wrap: anywhere; }
.tiles { display: grid; grid-template-columns: repeat(auto-fit, minmax(170px, 1fr)); gap: 10px; }
.tile { background: var(--card); border: 1px solid var(--line); border-radius: 8px; padding: 10px 12px; }
.tile b { display: block; font-size: 19px; font-variant-numeric: tabular-nums; }
  .tile span { color: var(--soft); font-size: 13px; }
.warn { border-left: 4px solid var(--warn); padding-left: 14px; margin-top: 22px; } .warn h2 { margin-top: 0; }
.warn ul { margin: 0; padding-left: 18px; }
.slider .stack { position: relative; line-height: 0; border-radius: 8px; overflow: hidden; border: 1px solid var(--line); }
.slider img { width: 100%; display: block; } .slider .above { position: absolute; inset: 0; height: 100%; }
.slider .bar { position: absolute; top: 0; bottom: 0; width: 2px; margin-left: -1px; background: #fff;
  box-shadow: 0 0 4px #000; }
.slider input { position: absolute; inset: 0; width: 100%; height: 100%; margin: 0; opacity: 0; cursor: ew-resize; }
.slider .stack:focus-within { outline: 2px solid #2f81f7; }
.tag { position: absolute; top: 8px; padding: 2px 8px; border-radius: 6px; background: #000a; color: #fff;
  font-size: 12px; line-height: 1.5; }
.tag.l { left: 8px; } .tag.r { right: 8px; } .said { color: var(--soft); margin: 6px 0 12px; }
.sheet { display: grid; grid-template-columns: repeat(auto-fill, minmax(200px, 1fr)); gap: 10px; }
figure { margin: 0; cursor: pointer; } figure img { width: 100%; display: block; border-radius: 6px;
  border: 2px solid transparent; }
figure img[hidden] { display: none; } figure.on img { border-color: #2f81f7; }
  figcaption { color: var(--soft); font-size: 13px; }
.plot { width: 100%; max-width: 960px; display: block; }
.legend { color: var(--soft); font-size: 13px; margin: 4px 0 12px; }
.legend i { display: inline-block; width: 12px; height: 12px; border-radius: 3px; margin: 0 4px 0 10px; vertical-align: -1px; }
.scroll { overflow-x: auto; } table { border-collapse: collapse; width: 100%; font-size: 14px; }
th, td { text-align: left; padding: 5px 10px; border-bottom: 1px solid var(--line); vertical-align: top; }
td { overflow-wrap: break-word; } td:first-child { overflow-wrap: normal; } th { color: var(--soft);
  font-weight: 600; white-space: nowrap; }
.num { text-align: right; font-variant-numeric: tabular-nums; white-space: nowrap; }
.ok { color: #2da44e; } .bad { color: var(--warn); }
.two { display: grid; grid-template-columns: repeat(auto-fit, minmax(min(340px, 100%), 1fr)); gap: 18px; align-items: start; }
</style></head><body>
@BODY@
<script>
(() => {
  const box = document.querySelector(".slider"), figures = [...document.querySelectorAll(".sheet figure")];
  if (!box || !figures.length) return;
  const above = box.querySelector(".above"), below = box.querySelector(".below"), bar = box.querySelector(".bar");
  const range = box.querySelector("input"), said = box.querySelector(".said");
  const cut = () => { above.style.clipPath = `inset(0 0 0 ${range.value}%)`; bar.style.left = range.value + "%"; };
  const show = figure => {
    figures.forEach(f => f.classList.toggle("on", f === figure));
    above.src = figure.querySelector(".out").src; below.src = figure.querySelector(".in").src;
    said.textContent = figure.dataset.said + " – drag to compare; choose another frame below";
  };
  figures.forEach(f => { f.onclick = () => show(f); f.onkeydown = e => { if (e.key === "Enter") show(f); }; });
  range.oninput = cut; box.hidden = false; cut(); show(figures[figures.length >> 1]);
})();
</script>
</body></html>
"""
)
