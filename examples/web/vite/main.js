import "splatwire";

const element = document.querySelector("splat-wire");
element.addEventListener("load", ({ detail }) => console.log("complete:", detail.complete));
