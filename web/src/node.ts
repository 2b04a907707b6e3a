// Modules of node, which are much faster than portable code.

interface NodeProcess {
  getBuiltinModule?(name: string): unknown;
}

/** Returns a module of node; undefined in pages and in versions of node that cannot load it this way. */
export const builtin = <T>(name: string): T | undefined =>
  (globalThis as { process?: NodeProcess }).process?.getBuiltinModule?.(`node:${name}`) as T | undefined;
