// Animation frames of the window that displays an element.

/** Work for the next animation frame. The script's own window may be hidden, and would have no frames. */
export class AnimationFrame {
  #work: FrameRequestCallback | null = null;
  #cancel: () => void = () => undefined;

  constructor(readonly element: Element) {}

  get isRequested(): boolean {
    return this.#work !== null;
  }

  /** Requests a frame instead of an earlier one. */
  request(work: FrameRequestCallback): void {
    this.cancel();
    const shown = this.element.ownerDocument.defaultView ?? window, // none if it is closed
      id = shown.requestAnimationFrame((now) => {
        this.#work = null;
        work(now);
      });
    this.#work = work;
    this.#cancel = () => shown.cancelAnimationFrame(id);
  }

  cancel(): void {
    this.#work = null;
    this.#cancel();
  }

  /** Requests the frame again, because another window displays the element now. */
  follow(): void {
    if (this.#work) this.request(this.#work);
  }
}
