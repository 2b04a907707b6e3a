// Looks of the element; dark or light as the system says.

export const STYLE = `
:host { display: block; position: relative; overflow: hidden; min-height: 8rem; background: #000;
  color-scheme: light dark;
  --paper: color-mix(in srgb, Canvas 88%, transparent); font: 13px/1.45 system-ui, sans-serif; }
.scene, canvas { position: absolute; inset: 0; width: 100%; height: 100%; display: block; }
.scene { touch-action: none; }
.scene:focus-visible { outline: 3px solid Highlight; outline-offset: -3px; }
canvas.over, canvas.first { pointer-events: none; visibility: hidden; }
canvas.over.shown, canvas.first.shown { visibility: visible; }
.panel { position: absolute; top: .75rem; right: .75rem; width: 17rem; max-width: calc(100% - 1.5rem);
  max-height: calc(100% - 1.5rem); overflow: auto; box-sizing: border-box; padding: .6rem .8rem;
  border-radius: .6rem; background: var(--paper); color: CanvasText; }
.panel summary { cursor: pointer; font-weight: 600; }
.state { margin: .3rem 0; overflow-wrap: anywhere; }
.state.bad { color: light-dark(#a00, #ff8a80); font-weight: 600; }
progress { width: 100%; height: .5rem; }
dl { display: grid; grid-template-columns: auto 1fr; gap: .1rem .8rem; margin: .4rem 0; }
dd { margin: 0; text-align: right; font-variant-numeric: tabular-nums; }
label, fieldset { display: block; margin: .4rem 0; }
fieldset { border: 0; padding: 0; display: flex; justify-content: space-between; }
input[type=radio] { margin: 0 .25rem 0 0; }
fieldset label { margin: 0; }
select, input[type=range] { width: 100%; box-sizing: border-box; }
button { font: inherit; margin: .2rem .3rem .2rem 0; }
@media (pointer: coarse) { button, select, summary, input[type=range], fieldset label { min-height: 44px; } }
.help { margin: .4rem 0 0; opacity: .75; }
`;
