// Style sheet of the element. The controls lie on the scene; laboratory and help are dark or light as in the system
// settings. Pages change colours by custom properties and everything else by parts.

export const STYLE = `
:host { display: block; position: relative; overflow: hidden; min-height: 8rem; background: #000;
  color-scheme: light dark; container-type: inline-size; font: 13px/1.45 system-ui, sans-serif;
  --accent: var(--splatwire-accent, #6ea8fe); --on-scene: var(--splatwire-controls, #fff); }
.whole { position: absolute; inset: 0; display: grid; overflow: hidden; container-type: size;
  grid-template: "scene side" minmax(0, 1fr) / minmax(0, 1fr) auto; }
.scene { grid-area: scene; position: relative; touch-action: none; cursor: grab; }
.scene:active { cursor: grabbing; }
canvas, .poster { position: absolute; inset: 0; width: 100%; height: 100%; }
.poster { object-fit: cover; pointer-events: none; }
canvas.over { grid-area: scene; position: static; }
.scene.cooperative { touch-action: pan-x pan-y; }
.hint { position: absolute; inset: auto 0 4.5rem; z-index: 1; width: fit-content; max-width: 90%; margin: 0 auto;
  padding: .4rem .9rem; border-radius: 2rem; color: #fff; background: #000c; pointer-events: none; opacity: 0;
  transition: opacity .3s; }
.hint.shown { opacity: 1; }
.scene:focus { outline: none; }
.scene:focus-visible::after { content: ""; position: absolute; inset: 0; pointer-events: none;
  border: 3px solid #fff; outline: 3px solid #1a56db; outline-offset: -6px; }
button:focus-visible, input:focus-visible, select:focus-visible { outline: 3px solid Highlight; outline-offset: 1px; }
.foot :focus-visible { outline: 2px solid; }
canvas.over, canvas.first { pointer-events: none; visibility: hidden; }
canvas.over.shown, canvas.first.shown { visibility: visible; }
.panel { display: contents; color: CanvasText; }
[hidden] { display: none !important; }
.hotspots { grid-area: scene; position: relative; overflow: hidden; pointer-events: none; }
::slotted([slot=hotspot]) { position: absolute; left: 0; top: 0; margin: 0; pointer-events: auto; visibility: hidden; }

.foot { grid-area: scene; align-self: end; position: relative; min-width: 0; color: var(--on-scene);
  transition: opacity .3s; }
.foot::before { content: ""; position: absolute; inset: -2rem 0 0; pointer-events: none;
  background: linear-gradient(transparent, #0009 55%, #000c); }
.idle .laboratory[hidden] ~ .foot:not(:focus-within) { opacity: 0; }
.bar { position: relative; display: flex; flex-wrap: wrap; align-items: center; gap: 0 .15rem;
  padding: .35rem .6rem .35rem .9rem; box-sizing: border-box; max-height: 50cqh; overflow: auto;
  text-shadow: 0 1px 2px #000; }
.bar p { margin: 0; }
.texts { flex: 1; min-width: 0; display: flex; flex-wrap: wrap; gap: 0 .6rem; align-items: baseline; }
.title { font-weight: 600; max-width: 100%; overflow: hidden; text-overflow: ellipsis; white-space: nowrap; }
.state { min-width: 0; overflow-wrap: anywhere; opacity: .85; }
.notice:not([hidden]) ~ .foot .state { position: absolute; clip-path: inset(50%); }
.state.bad { color: #ffb4ab; font-weight: 600; opacity: 1; }
.laboratory[hidden] ~ .foot .state.done { position: absolute; clip-path: inset(50%); }
.player { flex: 1 1 100%; align-items: center; gap: .6rem; white-space: nowrap; }
.player input { flex: 1; }
output { font-variant-numeric: tabular-nums; }
progress { position: absolute; inset: auto 0 0; z-index: 1; width: 100%; height: 3px; border: 0;
  appearance: none; background: #fff3; }
progress::-webkit-progress-bar { background: #fff3; }
progress::-webkit-progress-value { background: var(--accent); }
progress::-moz-progress-bar { background: var(--accent); }
progress.full { visibility: hidden; }

button { font: inherit; margin: .2rem .3rem .2rem 0; }
.bar button, .help > button { position: relative; flex: none; display: grid; place-items: center; width: 36px;
  height: 36px; margin: 0; padding: 0; border: 0; border-radius: 50%; color: inherit; background: none;
  cursor: pointer; overflow: hidden; }
.bar button:hover { background: #fff3; }
.bar button[aria-expanded=true], .bar button[aria-pressed=true] { background: #fff4; }
svg { width: 22px; height: 22px; fill: none; stroke: currentColor; stroke-width: 1.8; stroke-linecap: round;
  stroke-linejoin: round; }
.bar svg { filter: drop-shadow(0 1px 1px #0009); }
.name { position: absolute; width: 1px; height: 1px; overflow: hidden; clip-path: inset(50%); white-space: nowrap; }
input[type=range] { accent-color: var(--accent); }

.notice { grid-area: scene; place-self: center; z-index: 1; display: grid; justify-items: center; gap: .7rem;
  max-width: min(26rem, 85%); padding: 1.2rem 1.6rem; border-radius: 1rem; box-sizing: border-box; text-align: center;
  color: #fff; background: #1c1c1ee6; overflow-wrap: anywhere; }
.notice.loading { background: none; text-shadow: 0 1px 3px #000; }
.notice p { margin: 0; max-height: 40cqh; overflow: auto; }
.notice svg { width: 34px; height: 34px; color: #ffb4ab; }
.notice.offline svg { color: #ffd479; }
.notice button { margin: 0; padding: .45rem 1.2rem; border: 0; border-radius: 2rem; color: #0b1b33;
  background: var(--accent); font-weight: 600; cursor: pointer; }
.spinner { width: 34px; height: 34px; border: 3px solid #fff4; border-top-color: #fff; border-radius: 50%;
  box-sizing: border-box; animation: turn 1s linear infinite; }
@keyframes turn { to { rotate: 1turn; } }
@media (prefers-reduced-motion: reduce) { .spinner { animation: none; } }

.help { grid-area: scene; place-self: center; z-index: 2; position: relative; box-sizing: border-box;
  width: min(24rem, 92%); max-height: 90cqh; overflow: auto; padding: 1rem 1.3rem 1.2rem; border-radius: 1rem;
  color: CanvasText; background: Canvas; box-shadow: 0 .5rem 2rem #0008; }
.help > button { position: absolute; inset: .5rem .5rem auto auto; }
.help h2 { margin: .2rem 0 .3rem; font-size: 1.05em; }
.help dl { grid-template-columns: 11rem 1fr; gap: .25rem 1rem; margin: 0 0 .8rem; }
.help dt { font-weight: 600; }
.help dd { text-align: left; }
@media (pointer: coarse) { .help .keys { display: none; } }

.laboratory { grid-area: side; width: 17rem; overflow: auto; box-sizing: border-box; padding: .6rem .8rem;
  color: CanvasText; background: Canvas; }
.laboratory button, select { padding: .3rem .8rem; border: 1px solid light-dark(#bbb, #555); border-radius: .6rem;
  color: inherit; background: light-dark(#f4f4f4, #2a2a2a); }
.laboratory button:hover { background: light-dark(#e6e6e6, #3a3a3a); }
@container (max-width: 560px) {
  .whole { grid-template: "scene" minmax(50%, 1fr) "side" auto / minmax(0, 1fr); }
  .laboratory { width: auto; max-height: 40cqh; }
}
dl { display: grid; grid-template-columns: auto 1fr; gap: .1rem .8rem; margin: .4rem 0; }
dd { margin: 0; text-align: right; font-variant-numeric: tabular-nums; }
label { display: block; margin: .4rem 0; }
fieldset { border: 0; padding: 0; display: flex; justify-content: space-between; margin: 0; min-width: 0; }
fieldset label { margin: 0; }
input[type=radio] { margin: 0 .25rem 0 0; }
select, input[type=range] { width: 100%; box-sizing: border-box; }
@media (pointer: coarse) {
  button, select, input[type=range], fieldset label { min-height: 44px; }
  button, .bar button, .help > button { min-width: 44px; }
}
`;
