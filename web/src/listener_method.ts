/**
 * Type of `addEventListener` and `removeEventListener` of an object with typed events.
 *
 * `Target` is the type of the object, `Events` maps names to types of events, and `Options` are those of the method.
 */
export interface ListenerMethod<Target, Events, Options> {
  <Name extends keyof Events>(
    type: Name,
    listener: (this: Target, event: Events[Name]) => unknown,
    options?: boolean | Options,
  ): void;
  (type: string, listener: EventListenerOrEventListenerObject | null, options?: boolean | Options): void;
}
