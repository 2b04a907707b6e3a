// Made by web/scripts/make_tables.py; do not edit.

/** Standard normal distribution function from 0 to 6 by 1/128, less 1/2, out of 2^24: three bytes each, low first. */
export const UPPER_NORMAL =
  "AAAAQswAgJgBuGQC5zADCP0DGskEGZUFAWEG0CwHgvgHFcQIhI8JzVoK7SUL4fALpbsMNoYNklAOtRoPm+QPQ64QqXcRyUASoQkT" +
  "LtITbZoUWmIV8ykWNfEWHbgXp34Y0UQZmQoa+s8a85QbgFkcnx0dTOEdhqQeSGcfkSkgXusgrKwheG0ivy0jgO0jt6wkYmslfikm" +
  "COcm/6MnYGAoJxwpVNcp4pEq0UsrHQUsxb0sxXUtHC0uyOMuxpkvE08wrwMxlrcxyGoyQB0z/s4zAIA0QzA1xt81h442hDw3uuk3" +
  "KZY4zkE5p+w5tJY68j87X+g7+488wzY9tdw90YE+FSY/f8k/D2xAwg1Bl65BjU5Cou1C14tDKClElcVEHmFFwPtFe5VGTS5HN8ZH" +
  "Nl1ISfNIcYhJrBxK+a9KV0JLxtNLRWRM0/NMb4JNGhBO0ZxOlihPZ7NPQz1QK8ZQHk5RG9VRI1tSNOBSTmRTcudTn2lU1OpUEmtV" +
  "WepVqGhW/+VWX2JXxt1XNlhYrtFYL0pZuMFZSjha5K1ahyJbNJZb6ghcqnpcc+tcR1tdJspdEDheBaVeBhFfE3xfLuZfVk9gi7dg" +
  "zx5hI4Vhhuph+U5ifbJiExVju3Zjd9djRjdkKpZkI/RkMlFlWa1llwhm7mJmX7xm6hRnkWxnVcNnNRloNG5oU8JokhVp8mdpdblp" +
  "HApq51lq16hq7/ZqL0RrmJBrK9xr6SZs1HBs7blsNQJtrUltV5BtM9ZtRBtuiV9uBaNuueVupidvzWhvMKlv0OhvridwzGVwK6Nw" +
  "zN9wsRtx21ZxS5FxA8txBQRyUDxy6HNyzapyAeFyhRZzWktzg39z/7Jz0uVz+xd0fkl0Wnp0kap0Jtp0GQl1azd1H2V1NZJ1r751" +
  "jup11RV2g0B2m2p2H5R2Dr12bOV2OQ13dzR3J1t3SoF34qZ38ct3ePB3dxR48jd46Fp4W314TZ94wMB4s+F4KgJ5JCJ5pEF5q2B5" +
  "O395U51597p5J9h55PR5MBF6DC16ekh6emN6Dn56OJh6+LF6UMt6QeR6zfx69BR7uCx7GUR7Glt7vHF7/4d75Z17b7N7nsh7dN17" +
  "8fF7FwZ85xl8YS18iEB8XFN832V8EHh884l8h5t8zax8x718ds5829589+58y/58Vw59nh19nyx9XTt910l9D1h9BmZ9vXN9NIF9" +
  "bY59aZt9KKh9rLR99cB9BM192th9eOR93+99D/t9CgZ+0RB+Yxt+wiV+8C9+6zl+tkN+UU1+vVZ++19+C2l+7nF+pXp+MYN+kot+" +
  "yZN+1pt+u6N+eKt+DrN+fbp+xsF+6sh+6s9+xdZ+fd1+EuR+hOp+1vB+Bvd+Ff1+BQN/1gh/iA5/GxR/kRl/6h5/JiR/Ril/Sy5/" +
  "NDN/Azh/uDx/U0F/1UV/Pkp/kE5/yVJ/61Z/9lp/615/ymJ/k2Z/R2p/521/cXF/6HR/THh/nHt/2X5/BIJ/HIV/I4h/GYt//Y1/" +
  "0ZB/lZN/SJZ/7Jh/gJt/BZ5/e6B/46J/PaV/iKd/x6l/96t/G65/MrB/PbJ/O7R/LbZ/E7h/7rl/vrt/g71/PL9/7MB/kcJ/LMR/" +
  "vcV/RMd/wsh/Nsp/ost/Bc1/X85/sM9/+tB/O9J/dNN/ptR/0NV/8tZ/Dth/Itl/L9p/Ntt/Ntx/L91/I95/EN9/999/2OB/s+F/" +
  "ieJ/WuN/JeR/6uR/q+V/Z+Z/Hud/0Od/feh/Jul/y+l/a+p/B+t/n+t/M+x/w+x/T+1/2O1/XO5/3u5/XO9/1u9/TfB/wfB/MvF/" +
  "oPF/C/J/cvJ/2PJ/OvN/mvN/9/N/UfR/qfR///R/UvV/o/V/8fV/PvZ/iPZ/0PZ/Fvd/W/d/nfd/3vd/HPh/Wfh/lPh/zvh/Bvl/" +
  "PPl/cfl/pPl/1fl/Bvp/Nfp/Yvp/jvp/ufp/4/p/DPt/M/t/Wft/fvt/ovt/xft/5/t/CPx/J/x/Rvx/ZPx/gvx/nvx/ufx/1Px/" +
  "7vx/B/1/H/1/Nv1/Tf1/Y/1/ef1/jv1/ov1/tf1/yP1/2/1/7f1//v1/D/5/H/5/L/5/Pv5/Tf5/W/5/af5/dv5/g/5/kP5/nP5/" +
  "qP5/s/5/vv5/yf5/0/5/3f5/5/5/8f5/+v5/A/9/C/9/E/9/G/9/I/9/K/9/Mv9/Of9/QP9/Rv9/Tf9/U/9/Wf9/X/9/ZP9/af9/" +
  "b/9/dP9/ef9/ff9/gv9/hv9/i/9/j/9/k/9/lv9/mv9/nv9/of9/pf9/qP9/q/9/rv9/sf9/tP9/tv9/uf9/vP9/vv9/wP9/w/9/" +
  "xf9/x/9/yf9/y/9/zf9/z/9/0f9/0v9/1P9/1v9/1/9/2f9/2v9/2/9/3f9/3v9/3/9/4f9/4v9/4/9/5P9/5f9/5v9/5/9/6P9/" +
  "6f9/6v9/6/9/6/9/7P9/7f9/7v9/7v9/7/9/8P9/8P9/8f9/8f9/8v9/8v9/8/9/8/9/9P9/9P9/9f9/9f9/9v9/9v9/9/9/9/9/" +
  "9/9/+P9/+P9/+P9/+f9/+f9/+f9/+f9/+v9/+v9/+v9/+v9/+/9/+/9/+/9/+/9/+/9//P9//P9//P9//P9//P9//P9//f9//f9/" +
  "/f9//f9//f9//f9//f9//f9//v9//v9//v9//v9//v9//v9//v9//v9//v9//v9//v9//v9//v9///9///9///9///9///9///9/" +
  "//9///9///9///9///9///9///9///9///9///9///9///9///9///9///9///9///9///9///9/AACAAACAAACAAACAAACAAACA" +
  "AACAAACAAACAAACAAACAAACAAACAAACAAACAAACAAACAAACAAACAAACAAACAAACAAACAAACAAACAAACAAACAAACAAACAAACAAACA" +
  "AACAAACAAACAAACAAACAAACAAACAAACAAACAAACAAACAAACAAACAAACAAACAAACAAACAAACAAACAAACAAACAAACAAACAAACAAACA" +
  "AACAAACAAACAAACAAACAAACAAACAAACAAACAAACAAACAAACAAACAAACAAACAAACAAACAAACAAACA";
