/* splatwire 0.2.0 web receiver, Apache-2.0; with PlayCanvas (MIT) and @noble/hashes (MIT) */
var o_="GpuTimings";var tl="2.23.3",n_="b7655d8";function el(l,e){for(let t in e){let s=e[t];Array.isArray(s)?l[t]=el([],s):s&&typeof s=="object"?l[t]=el({},s):l[t]=s}return l}var l_={create(){return"xxxxxxxx-xxxx-4xxx-yxxx-xxxxxxxxxxxx".replace(/[xy]/g,l=>{let e=Math.random()*16|0;return(l==="x"?e:e&3|8).toString(16)})}};var oe={delimiter:"/",join(...l){let e=l[0];for(let t=0;t<l.length-1;t++){let s=l[t],r=l[t+1];if(r[0]===oe.delimiter){e=r;continue}s&&r&&s[s.length-1]!==oe.delimiter&&r[0]!==oe.delimiter?e+=oe.delimiter+r:e+=r}return e},normalize(l){let e=l.startsWith(oe.delimiter),t=l.endsWith(oe.delimiter),s=l.split("/"),r="",i=[];for(let a=0;a<s.length;a++)if(s[a]!==""&&s[a]!=="."){if(s[a]===".."&&i.length>0){i=i.slice(0,i.length-2);continue}a>0&&i.push(oe.delimiter),i.push(s[a])}return r=i.join(""),!e&&r[0]===oe.delimiter&&(r=r.slice(1)),t&&r[r.length-1]!==oe.delimiter&&(r+=oe.delimiter),r},split(l){let e=l.lastIndexOf(oe.delimiter);return e!==-1?[l.substring(0,e),l.substring(e+1)]:["",l]},getBasename(l){return oe.split(l)[1]},getDirectory(l){return oe.split(l)[0]},getExtension(l){let e=l.split("?")[0].split(".").pop();return e!==l?`.${e}`:""},isRelativePath(l){return l.charAt(0)!=="/"&&l.match(/:\/\//)===null},extractPath(l){let e="",t=l.split("/"),s=0;if(t.length>1)if(oe.isRelativePath(l))if(t[0]===".")for(s=0;s<t.length-1;++s)e+=s===0?t[s]:`/${t[s]}`;else if(t[0]==="..")for(s=0;s<t.length-1;++s)e+=s===0?t[s]:`/${t[s]}`;else for(e=".",s=0;s<t.length-1;++s)e+=`/${t[s]}`;else for(s=0;s<t.length-1;++s)e+=s===0?t[s]:`/${t[s]}`;return e}};var Wt=typeof navigator<"u"?navigator.userAgent:"",Xs=typeof window<"u"?"browser":typeof global<"u"?"node":"worker",So=/android/i.test(Wt)?"android":/ip(?:[ao]d|hone)/i.test(Wt)?"ios":/windows/i.test(Wt)?"windows":/mac os/i.test(Wt)?"osx":/linux/i.test(Wt)?"linux":/cros/i.test(Wt)?"cros":null,vA=Xs!=="browser"?null:/Chrome\/|Chromium\/|Edg.*\//.test(Wt)?"chrome":/Safari\//.test(Wt)?"safari":/Firefox\//.test(Wt)?"firefox":"other",xA=/xbox/i.test(Wt),AA=/Macintosh/i.test(Wt)&&typeof navigator<"u"&&navigator.maxTouchPoints>0&&!/iPhone|iPad|iPod/i.test(Wt),RA=Xs==="browser"&&("ontouchstart"in window||"maxTouchPoints"in navigator&&navigator.maxTouchPoints>0),PA=Xs==="browser"&&(!!navigator.getGamepads||!!navigator.webkitGetGamepads),DA=typeof Worker<"u",Oe={name:So,environment:Xs,global:(typeof globalThis<"u"&&globalThis)??(Xs==="browser"&&window)??(Xs==="node"&&global)??(Xs==="worker"&&self),browser:Xs==="browser",worker:Xs==="worker",desktop:["windows","osx","linux","cros"].includes(So),mobile:["android","ios"].includes(So),ios:So==="ios",android:So==="android",visionos:AA,xbox:xA,gamepads:PA,touch:RA,workers:DA,browserName:vA};var sl=class{handler;name;callback;scope;_once;_removed=!1;constructor(e,t,s,r,i=!1){this.handler=e,this.name=t,this.callback=s,this.scope=r,this._once=i}off(){this._removed||this.handler.offByHandle(this)}on(e,t,s=this){return this.handler._addCallback(e,t,s,!1)}once(e,t,s=this){return this.handler._addCallback(e,t,s,!0)}set removed(e){e&&(this._removed=!0)}get removed(){return this._removed}toJSON(e){}};var de=class{_callbacks=new Map;_callbackActive=new Map;initEventHandler(){this._callbacks=new Map,this._callbackActive=new Map}_addCallback(e,t,s,r){if(this._callbacks.has(e)||this._callbacks.set(e,[]),this._callbackActive.has(e)){let a=this._callbackActive.get(e);a&&a===this._callbacks.get(e)&&this._callbackActive.set(e,a.slice())}let i=new sl(this,e,t,s,r);return this._callbacks.get(e).push(i),i}on(e,t,s=this){return this._addCallback(e,t,s,!1)}once(e,t,s=this){return this._addCallback(e,t,s,!0)}off(e,t,s){if(e)this._callbackActive.has(e)&&this._callbackActive.get(e)===this._callbacks.get(e)&&this._callbackActive.set(e,this._callbackActive.get(e).slice());else for(let[r,i]of this._callbackActive)this._callbacks.has(r)&&this._callbacks.get(r)===i&&this._callbackActive.set(r,i.slice());if(e)if(t){let r=this._callbacks.get(e);if(!r)return this;for(let i=0;i<r.length;i++)r[i].callback===t&&(s&&r[i].scope!==s||(r[i].removed=!0,r.splice(i,1),i--));r.length===0&&this._callbacks.delete(e)}else{let r=this._callbacks.get(e);if(r){for(let i=0;i<r.length;i++)r[i].removed=!0;this._callbacks.delete(e)}}else{for(let r of this._callbacks.values())for(let i=0;i<r.length;i++)r[i].removed=!0;this._callbacks.clear()}return this}offByHandle(e){let t=e.name;e.removed=!0,this._callbackActive.has(t)&&this._callbackActive.get(t)===this._callbacks.get(t)&&this._callbackActive.set(t,this._callbackActive.get(t).slice());let s=this._callbacks.get(t);if(!s)return this;let r=s.indexOf(e);return r!==-1&&(s.splice(r,1),s.length===0&&this._callbacks.delete(t)),this}fire(e,t,s,r,i,a,o,n,c){if(!e)return this;let h=this._callbacks.get(e);if(!h)return this;let d;this._callbackActive.has(e)?this._callbackActive.get(e)!==h&&(d=h.slice()):this._callbackActive.set(e,h);for(let f=0;(d||this._callbackActive.get(e))&&f<(d||this._callbackActive.get(e)).length;f++){let u=(d||this._callbackActive.get(e))[f];if(u.callback&&(u.callback.call(u.scope,t,s,r,i,a,o,n,c),u._once)){let m=this._callbacks.get(e),_=m?m.indexOf(u):-1;if(_!==-1){this._callbackActive.get(e)===m&&this._callbackActive.set(e,this._callbackActive.get(e).slice());let p=this._callbacks.get(e);if(!p)continue;p[_].removed=!0,p.splice(_,1),p.length===0&&this._callbacks.delete(e)}}}return d||this._callbackActive.delete(e),this}hasEvent(e){return!!this._callbacks.get(e)?.length}};var Bi=class extends de{static EVENT_ADD="add";static EVENT_REMOVE="remove";static EVENT_CHANGE="change";_index={};_list=[];_parent;constructor(e){super(),this._parent=e}add(...e){let t=!1,s=this._processArguments(e,!0);if(!s.length)return t;for(let r=0;r<s.length;r++)this._index[s[r]]||(t=!0,this._index[s[r]]=!0,this._list.push(s[r]),this.fire("add",s[r],this._parent));return t&&this.fire("change",this._parent),t}remove(...e){let t=!1;if(!this._list.length)return t;let s=this._processArguments(e,!0);if(!s.length)return t;for(let r=0;r<s.length;r++)this._index[s[r]]&&(t=!0,delete this._index[s[r]],this._list.splice(this._list.indexOf(s[r]),1),this.fire("remove",s[r],this._parent));return t&&this.fire("change",this._parent),t}clear(){if(!this._list.length)return;let e=this._list.slice(0);this._list=[],this._index={};for(let t=0;t<e.length;t++)this.fire("remove",e[t],this._parent);this.fire("change",this._parent)}has(...e){return this._list.length?this._has(this._processArguments(e)):!1}_has(e){if(!this._list.length||!e.length)return!1;for(let t=0;t<e.length;t++)if(e[t].length===1){if(this._index[e[t][0]])return!0}else{let s=!0;for(let r=0;r<e[t].length;r++)if(!this._index[e[t][r]]){s=!1;break}if(s)return!0}return!1}list(){return this._list.slice(0)}_processArguments(e,t){let s=[],r=[];if(!e||!e.length)return s;for(let i=0;i<e.length;i++)if(e[i]instanceof Array){t||(r=[]);for(let a=0;a<e[i].length;a++)typeof e[i][a]=="string"&&(t?s.push(e[i][a]):r.push(e[i][a]));!t&&r.length&&s.push(r)}else typeof e[i]=="string"&&(t?s.push(e[i]):s.push([e[i]]));return s}get size(){return this._list.length}};var mt=typeof window<"u"&&window.performance&&window.performance.now?performance.now.bind(performance):Date.now;var IA=/^(([^:/?#]+):)?(\/\/([^/?#]*))?([^?#]*)(\?([^#]*))?(#(.*))?/,Ui=class{scheme;authority;path;query;fragment;constructor(e){let t=e.match(IA);this.scheme=t[2],this.authority=t[4],this.path=t[5],this.query=t[7],this.fragment=t[9]}toString(){let e="";return this.scheme&&(e+=`${this.scheme}:`),this.authority&&(e+=`//${this.authority}`),e+=this.path,this.query&&(e+=`?${this.query}`),this.fragment&&(e+=`#${this.fragment}`),e}getQuery(){let e={};if(this.query){let t=decodeURIComponent(this.query).split("&");for(let s of t){let r=s.split("=");e[r[0]]=r[1]}}return e}setQuery(e){let t="";for(let s in e)e.hasOwnProperty(s)&&(t!==""&&(t+="&"),t+=`${encodeURIComponent(s)}=${encodeURIComponent(e[s])}`);this.query=t}};var rl=class l{static _traceChannels=new Set;static stack=!1;static set(e,t=!0){}static get(e){return l._traceChannels.has(e)}};var O={DEG_TO_RAD:Math.PI/180,RAD_TO_DEG:180/Math.PI,clamp(l,e,t){return l>=t?t:l<=e?e:l},intToBytes24(l){let e=l>>16&255,t=l>>8&255,s=l&255;return[e,t,s]},intToBytes32(l){let e=l>>24&255,t=l>>16&255,s=l>>8&255,r=l&255;return[e,t,s,r]},bytesToInt24(l,e,t){return l.length&&(t=l[2],e=l[1],l=l[0]),l<<16|e<<8|t},bytesToInt32(l,e,t,s){return l.length&&(s=l[3],t=l[2],e=l[1],l=l[0]),(l<<24|e<<16|t<<8|s)>>>0},lerp(l,e,t){return l+(e-l)*O.clamp(t,0,1)},lerpUnclamped(l,e,t){return l+(e-l)*t},lerpAngle(l,e,t){return e-l>180&&(e-=360),e-l<-180&&(e+=360),O.lerp(l,e,O.clamp(t,0,1))},powerOfTwo(l){return l!==0&&!(l&l-1)},nextPowerOfTwo(l){return l--,l|=l>>1,l|=l>>2,l|=l>>4,l|=l>>8,l|=l>>16,l++,l},nearestPowerOfTwo(l){return Math.pow(2,Math.round(Math.log2(l)))},random(l,e){let t=e-l;return Math.random()*t+l},smoothstep(l,e,t){return t<=l?0:t>=e?1:(t=(t-l)/(e-l),t*t*(3-2*t))},smootherstep(l,e,t){return t<=l?0:t>=e?1:(t=(t-l)/(e-l),t*t*t*(t*(t*6-15)+10))},roundUp(l,e){return e===0?l:Math.ceil(l/e)*e},between(l,e,t,s){let r=Math.min(e,t),i=Math.max(e,t);return s?l>=r&&l<=i:l>r&&l<i}};var z=class l{r;g;b;a;constructor(e=0,t=0,s=0,r=1){let i=e.length;i===3||i===4?(this.r=e[0],this.g=e[1],this.b=e[2],this.a=e[3]??1):(this.r=e,this.g=t,this.b=s,this.a=r)}clone(){let e=this.constructor;return new e(this.r,this.g,this.b,this.a)}copy(e){return this.r=e.r,this.g=e.g,this.b=e.b,this.a=e.a,this}equals(e){return this.r===e.r&&this.g===e.g&&this.b===e.b&&this.a===e.a}set(e,t,s,r=1){return this.r=e,this.g=t,this.b=s,this.a=r,this}lerp(e,t,s){return this.r=e.r+s*(t.r-e.r),this.g=e.g+s*(t.g-e.g),this.b=e.b+s*(t.b-e.b),this.a=e.a+s*(t.a-e.a),this}linear(e=this){return this.r=Math.pow(e.r,2.2),this.g=Math.pow(e.g,2.2),this.b=Math.pow(e.b,2.2),this.a=e.a,this}gamma(e=this){return this.r=Math.pow(e.r,1/2.2),this.g=Math.pow(e.g,1/2.2),this.b=Math.pow(e.b,1/2.2),this.a=e.a,this}mulScalar(e){return this.r*=e,this.g*=e,this.b*=e,this}fromString(e){let t=parseInt(e.replace("#","0x"),16),s;return e.length>7?s=O.intToBytes32(t):(s=O.intToBytes24(t),s[3]=255),this.set(s[0]/255,s[1]/255,s[2]/255,s[3]/255),this}fromArray(e,t=0){return this.r=e[t]??this.r,this.g=e[t+1]??this.g,this.b=e[t+2]??this.b,this.a=e[t+3]??this.a,this}toString(e,t){let{r:s,g:r,b:i,a}=this;if(t||s>1||r>1||i>1)return`${s.toFixed(3)}, ${r.toFixed(3)}, ${i.toFixed(3)}, ${a.toFixed(3)}`;let o=`#${((1<<24)+(Math.round(s*255)<<16)+(Math.round(r*255)<<8)+Math.round(i*255)).toString(16).slice(1)}`;if(e===!0){let n=Math.round(a*255).toString(16);this.a<16/255?o+=`0${n}`:o+=n}return o}toArray(e=[],t=0,s=!0){return e[t]=this.r,e[t+1]=this.g,e[t+2]=this.b,s&&(e[t+3]=this.a),e}static BLACK=Object.freeze(new l(0,0,0,1));static BLUE=Object.freeze(new l(0,0,1,1));static CYAN=Object.freeze(new l(0,1,1,1));static GRAY=Object.freeze(new l(.5,.5,.5,1));static GREEN=Object.freeze(new l(0,1,0,1));static MAGENTA=Object.freeze(new l(1,0,1,1));static RED=Object.freeze(new l(1,0,0,1));static WHITE=Object.freeze(new l(1,1,1,1));static YELLOW=Object.freeze(new l(1,1,0,1))};var kf=new Float32Array(1),c_=new Int32Array(kf.buffer),gs=class{static float2Half(e){kf[0]=e;let t=c_[0],s=t>>16&32768,r=t>>12&2047,i=t>>23&255;return i<103?(i===102&&t&8388607&&(s|=1),s):i>142?(s|=31744,i===255&&t&8388607&&(s|=512),s):i<113?(r|=2048,s|=(r>>114-i)+(r>>113-i&1),s):(s|=i-112<<10|r>>1,s+=r&1,s)}static float2RGBA8(e,t){kf[0]=e;let s=c_[0];t.r=(s>>24&255)/255,t.g=(s>>16&255)/255,t.b=(s>>8&255)/255,t.a=(s&255)/255}};var y=class l{x;y;z;constructor(e=0,t=0,s=0){e.length===3?(this.x=e[0],this.y=e[1],this.z=e[2]):(this.x=e,this.y=t,this.z=s)}add(e){return this.x+=e.x,this.y+=e.y,this.z+=e.z,this}add2(e,t){return this.x=e.x+t.x,this.y=e.y+t.y,this.z=e.z+t.z,this}addScalar(e){return this.x+=e,this.y+=e,this.z+=e,this}addScaled(e,t){return this.x+=e.x*t,this.y+=e.y*t,this.z+=e.z*t,this}clone(){let e=this.constructor;return new e(this.x,this.y,this.z)}copy(e){return this.x=e.x,this.y=e.y,this.z=e.z,this}cross(e,t){let s=e.x,r=e.y,i=e.z,a=t.x,o=t.y,n=t.z;return this.x=r*n-o*i,this.y=i*a-n*s,this.z=s*o-a*r,this}distance(e){let t=this.x-e.x,s=this.y-e.y,r=this.z-e.z;return Math.sqrt(t*t+s*s+r*r)}distanceSq(e){let t=this.x-e.x,s=this.y-e.y,r=this.z-e.z;return t*t+s*s+r*r}div(e){return this.x/=e.x,this.y/=e.y,this.z/=e.z,this}div2(e,t){return this.x=e.x/t.x,this.y=e.y/t.y,this.z=e.z/t.z,this}divScalar(e){return this.x/=e,this.y/=e,this.z/=e,this}dot(e){return this.x*e.x+this.y*e.y+this.z*e.z}equals(e){return this.x===e.x&&this.y===e.y&&this.z===e.z}equalsApprox(e,t=1e-6){return Math.abs(this.x-e.x)<t&&Math.abs(this.y-e.y)<t&&Math.abs(this.z-e.z)<t}length(){return Math.sqrt(this.x*this.x+this.y*this.y+this.z*this.z)}lengthSq(){return this.x*this.x+this.y*this.y+this.z*this.z}lerp(e,t,s){return this.x=e.x+s*(t.x-e.x),this.y=e.y+s*(t.y-e.y),this.z=e.z+s*(t.z-e.z),this}mul(e){return this.x*=e.x,this.y*=e.y,this.z*=e.z,this}mul2(e,t){return this.x=e.x*t.x,this.y=e.y*t.y,this.z=e.z*t.z,this}mulScalar(e){return this.x*=e,this.y*=e,this.z*=e,this}scale(e){return this.mulScalar(e)}normalize(e=this){let t=e.x*e.x+e.y*e.y+e.z*e.z;if(t>0){let s=1/Math.sqrt(t);this.x=e.x*s,this.y=e.y*s,this.z=e.z*s}return this}floor(e=this){return this.x=Math.floor(e.x),this.y=Math.floor(e.y),this.z=Math.floor(e.z),this}ceil(e=this){return this.x=Math.ceil(e.x),this.y=Math.ceil(e.y),this.z=Math.ceil(e.z),this}round(e=this){return this.x=Math.round(e.x),this.y=Math.round(e.y),this.z=Math.round(e.z),this}min(e){return e.x<this.x&&(this.x=e.x),e.y<this.y&&(this.y=e.y),e.z<this.z&&(this.z=e.z),this}max(e){return e.x>this.x&&(this.x=e.x),e.y>this.y&&(this.y=e.y),e.z>this.z&&(this.z=e.z),this}project(e){let t=this.x*e.x+this.y*e.y+this.z*e.z,s=e.x*e.x+e.y*e.y+e.z*e.z,r=t/s;return this.x=e.x*r,this.y=e.y*r,this.z=e.z*r,this}set(e,t,s){return this.x=e,this.y=t,this.z=s,this}sub(e){return this.x-=e.x,this.y-=e.y,this.z-=e.z,this}sub2(e,t){return this.x=e.x-t.x,this.y=e.y-t.y,this.z=e.z-t.z,this}subScalar(e){return this.x-=e,this.y-=e,this.z-=e,this}fromArray(e,t=0){return this.x=e[t]??this.x,this.y=e[t+1]??this.y,this.z=e[t+2]??this.z,this}toString(){return`[${this.x}, ${this.y}, ${this.z}]`}toArray(e=[],t=0){return e[t]=this.x,e[t+1]=this.y,e[t+2]=this.z,e}static ZERO=Object.freeze(new l(0,0,0));static HALF=Object.freeze(new l(.5,.5,.5));static ONE=Object.freeze(new l(1,1,1));static UP=Object.freeze(new l(0,1,0));static DOWN=Object.freeze(new l(0,-1,0));static RIGHT=Object.freeze(new l(1,0,0));static LEFT=Object.freeze(new l(-1,0,0));static FORWARD=Object.freeze(new l(0,0,-1));static BACK=Object.freeze(new l(0,0,1))};var Ss=class l{data=new Float32Array(9);constructor(){this.data[0]=this.data[4]=this.data[8]=1}clone(){let e=this.constructor;return new e().copy(this)}copy(e){let t=e.data,s=this.data;return s[0]=t[0],s[1]=t[1],s[2]=t[2],s[3]=t[3],s[4]=t[4],s[5]=t[5],s[6]=t[6],s[7]=t[7],s[8]=t[8],this}set(e){let t=this.data;return t[0]=e[0],t[1]=e[1],t[2]=e[2],t[3]=e[3],t[4]=e[4],t[5]=e[5],t[6]=e[6],t[7]=e[7],t[8]=e[8],this}getX(e=new y){return e.set(this.data[0],this.data[1],this.data[2])}getY(e=new y){return e.set(this.data[3],this.data[4],this.data[5])}getZ(e=new y){return e.set(this.data[6],this.data[7],this.data[8])}equals(e){let t=this.data,s=e.data;return t[0]===s[0]&&t[1]===s[1]&&t[2]===s[2]&&t[3]===s[3]&&t[4]===s[4]&&t[5]===s[5]&&t[6]===s[6]&&t[7]===s[7]&&t[8]===s[8]}isIdentity(){let e=this.data;return e[0]===1&&e[1]===0&&e[2]===0&&e[3]===0&&e[4]===1&&e[5]===0&&e[6]===0&&e[7]===0&&e[8]===1}setIdentity(){let e=this.data;return e[0]=1,e[1]=0,e[2]=0,e[3]=0,e[4]=1,e[5]=0,e[6]=0,e[7]=0,e[8]=1,this}toString(){return`[${this.data.join(", ")}]`}transpose(e=this){let t=e.data,s=this.data;if(t===s){let r;r=t[1],s[1]=t[3],s[3]=r,r=t[2],s[2]=t[6],s[6]=r,r=t[5],s[5]=t[7],s[7]=r}else s[0]=t[0],s[1]=t[3],s[2]=t[6],s[3]=t[1],s[4]=t[4],s[5]=t[7],s[6]=t[2],s[7]=t[5],s[8]=t[8];return this}setFromMat4(e){let t=e.data,s=this.data;return s[0]=t[0],s[1]=t[1],s[2]=t[2],s[3]=t[4],s[4]=t[5],s[5]=t[6],s[6]=t[8],s[7]=t[9],s[8]=t[10],this}setFromQuat(e){let t=e.x,s=e.y,r=e.z,i=e.w,a=t+t,o=s+s,n=r+r,c=t*a,h=t*o,d=t*n,f=s*o,u=s*n,m=r*n,_=i*a,p=i*o,g=i*n,T=this.data;return T[0]=1-(f+m),T[1]=h+g,T[2]=d-p,T[3]=h-g,T[4]=1-(c+m),T[5]=u+_,T[6]=d+p,T[7]=u-_,T[8]=1-(c+f),this}invertMat4(e){let t=e.data,s=t[0],r=t[1],i=t[2],a=t[4],o=t[5],n=t[6],c=t[8],h=t[9],d=t[10],f=d*o-n*h,u=-d*r+i*h,m=n*r-i*o,_=-d*a+n*c,p=d*s-i*c,g=-n*s+i*a,T=h*a-o*c,S=-h*s+r*c,x=o*s-r*a,C=s*f+r*_+i*T;if(C===0)this.setIdentity();else{let E=1/C,v=this.data;v[0]=f*E,v[1]=u*E,v[2]=m*E,v[3]=_*E,v[4]=p*E,v[5]=g*E,v[6]=T*E,v[7]=S*E,v[8]=x*E}return this}transformVector(e,t=new y){let s=this.data,{x:r,y:i,z:a}=e;return t.x=r*s[0]+i*s[3]+a*s[6],t.y=r*s[1]+i*s[4]+a*s[7],t.z=r*s[2]+i*s[5]+a*s[8],t}static IDENTITY=Object.freeze(new l);static ZERO=Object.freeze(new l().set([0,0,0,0,0,0,0,0,0]))};var k=class l{x;y;constructor(e=0,t=0){e.length===2?(this.x=e[0],this.y=e[1]):(this.x=e,this.y=t)}add(e){return this.x+=e.x,this.y+=e.y,this}add2(e,t){return this.x=e.x+t.x,this.y=e.y+t.y,this}addScalar(e){return this.x+=e,this.y+=e,this}addScaled(e,t){return this.x+=e.x*t,this.y+=e.y*t,this}clone(){let e=this.constructor;return new e(this.x,this.y)}copy(e){return this.x=e.x,this.y=e.y,this}cross(e){return this.x*e.y-this.y*e.x}distance(e){let t=this.x-e.x,s=this.y-e.y;return Math.sqrt(t*t+s*s)}distanceSq(e){let t=this.x-e.x,s=this.y-e.y;return t*t+s*s}div(e){return this.x/=e.x,this.y/=e.y,this}div2(e,t){return this.x=e.x/t.x,this.y=e.y/t.y,this}divScalar(e){return this.x/=e,this.y/=e,this}dot(e){return this.x*e.x+this.y*e.y}equals(e){return this.x===e.x&&this.y===e.y}equalsApprox(e,t=1e-6){return Math.abs(this.x-e.x)<t&&Math.abs(this.y-e.y)<t}length(){return Math.sqrt(this.x*this.x+this.y*this.y)}lengthSq(){return this.x*this.x+this.y*this.y}lerp(e,t,s){return this.x=e.x+s*(t.x-e.x),this.y=e.y+s*(t.y-e.y),this}mul(e){return this.x*=e.x,this.y*=e.y,this}mul2(e,t){return this.x=e.x*t.x,this.y=e.y*t.y,this}mulScalar(e){return this.x*=e,this.y*=e,this}scale(e){return this.mulScalar(e)}normalize(e=this){let t=e.x*e.x+e.y*e.y;if(t>0){let s=1/Math.sqrt(t);this.x=e.x*s,this.y=e.y*s}return this}rotate(e){let t=Math.atan2(this.x,this.y)+e*O.DEG_TO_RAD,s=Math.sqrt(this.x*this.x+this.y*this.y);return this.x=Math.sin(t)*s,this.y=Math.cos(t)*s,this}angle(){return Math.atan2(this.x,this.y)*O.RAD_TO_DEG}angleTo(e){return Math.atan2(this.x*e.y+this.y*e.x,this.x*e.x+this.y*e.y)*O.RAD_TO_DEG}floor(e=this){return this.x=Math.floor(e.x),this.y=Math.floor(e.y),this}ceil(e=this){return this.x=Math.ceil(e.x),this.y=Math.ceil(e.y),this}round(e=this){return this.x=Math.round(e.x),this.y=Math.round(e.y),this}min(e){return e.x<this.x&&(this.x=e.x),e.y<this.y&&(this.y=e.y),this}max(e){return e.x>this.x&&(this.x=e.x),e.y>this.y&&(this.y=e.y),this}set(e,t){return this.x=e,this.y=t,this}sub(e){return this.x-=e.x,this.y-=e.y,this}sub2(e,t){return this.x=e.x-t.x,this.y=e.y-t.y,this}subScalar(e){return this.x-=e,this.y-=e,this}fromArray(e,t=0){return this.x=e[t]??this.x,this.y=e[t+1]??this.y,this}toString(){return`[${this.x}, ${this.y}]`}toArray(e=[],t=0){return e[t]=this.x,e[t+1]=this.y,e}static angleRad(e,t){return Math.atan2(e.x*t.y-e.y*t.x,e.x*t.x+e.y*t.y)}static ZERO=Object.freeze(new l(0,0));static HALF=Object.freeze(new l(.5,.5));static ONE=Object.freeze(new l(1,1));static UP=Object.freeze(new l(0,1));static DOWN=Object.freeze(new l(0,-1));static RIGHT=Object.freeze(new l(1,0));static LEFT=Object.freeze(new l(-1,0))};var ne=class l{x;y;z;w;constructor(e=0,t=0,s=0,r=0){e.length===4?(this.x=e[0],this.y=e[1],this.z=e[2],this.w=e[3]):(this.x=e,this.y=t,this.z=s,this.w=r)}add(e){return this.x+=e.x,this.y+=e.y,this.z+=e.z,this.w+=e.w,this}add2(e,t){return this.x=e.x+t.x,this.y=e.y+t.y,this.z=e.z+t.z,this.w=e.w+t.w,this}addScalar(e){return this.x+=e,this.y+=e,this.z+=e,this.w+=e,this}addScaled(e,t){return this.x+=e.x*t,this.y+=e.y*t,this.z+=e.z*t,this.w+=e.w*t,this}clone(){let e=this.constructor;return new e(this.x,this.y,this.z,this.w)}copy(e){return this.x=e.x,this.y=e.y,this.z=e.z,this.w=e.w,this}div(e){return this.x/=e.x,this.y/=e.y,this.z/=e.z,this.w/=e.w,this}div2(e,t){return this.x=e.x/t.x,this.y=e.y/t.y,this.z=e.z/t.z,this.w=e.w/t.w,this}divScalar(e){return this.x/=e,this.y/=e,this.z/=e,this.w/=e,this}dot(e){return this.x*e.x+this.y*e.y+this.z*e.z+this.w*e.w}equals(e){return this.x===e.x&&this.y===e.y&&this.z===e.z&&this.w===e.w}equalsApprox(e,t=1e-6){return Math.abs(this.x-e.x)<t&&Math.abs(this.y-e.y)<t&&Math.abs(this.z-e.z)<t&&Math.abs(this.w-e.w)<t}length(){return Math.sqrt(this.x*this.x+this.y*this.y+this.z*this.z+this.w*this.w)}lengthSq(){return this.x*this.x+this.y*this.y+this.z*this.z+this.w*this.w}lerp(e,t,s){return this.x=e.x+s*(t.x-e.x),this.y=e.y+s*(t.y-e.y),this.z=e.z+s*(t.z-e.z),this.w=e.w+s*(t.w-e.w),this}mul(e){return this.x*=e.x,this.y*=e.y,this.z*=e.z,this.w*=e.w,this}mul2(e,t){return this.x=e.x*t.x,this.y=e.y*t.y,this.z=e.z*t.z,this.w=e.w*t.w,this}mulScalar(e){return this.x*=e,this.y*=e,this.z*=e,this.w*=e,this}scale(e){return this.mulScalar(e)}normalize(e=this){let t=e.x*e.x+e.y*e.y+e.z*e.z+e.w*e.w;if(t>0){let s=1/Math.sqrt(t);this.x=e.x*s,this.y=e.y*s,this.z=e.z*s,this.w=e.w*s}return this}floor(e=this){return this.x=Math.floor(e.x),this.y=Math.floor(e.y),this.z=Math.floor(e.z),this.w=Math.floor(e.w),this}ceil(e=this){return this.x=Math.ceil(e.x),this.y=Math.ceil(e.y),this.z=Math.ceil(e.z),this.w=Math.ceil(e.w),this}round(e=this){return this.x=Math.round(e.x),this.y=Math.round(e.y),this.z=Math.round(e.z),this.w=Math.round(e.w),this}min(e){return e.x<this.x&&(this.x=e.x),e.y<this.y&&(this.y=e.y),e.z<this.z&&(this.z=e.z),e.w<this.w&&(this.w=e.w),this}max(e){return e.x>this.x&&(this.x=e.x),e.y>this.y&&(this.y=e.y),e.z>this.z&&(this.z=e.z),e.w>this.w&&(this.w=e.w),this}set(e,t,s,r){return this.x=e,this.y=t,this.z=s,this.w=r,this}sub(e){return this.x-=e.x,this.y-=e.y,this.z-=e.z,this.w-=e.w,this}sub2(e,t){return this.x=e.x-t.x,this.y=e.y-t.y,this.z=e.z-t.z,this.w=e.w-t.w,this}subScalar(e){return this.x-=e,this.y-=e,this.z-=e,this.w-=e,this}fromArray(e,t=0){return this.x=e[t]??this.x,this.y=e[t+1]??this.y,this.z=e[t+2]??this.z,this.w=e[t+3]??this.w,this}toString(){return`[${this.x}, ${this.y}, ${this.z}, ${this.w}]`}toArray(e=[],t=0){return e[t]=this.x,e[t+1]=this.y,e[t+2]=this.z,e[t+3]=this.w,e}static ZERO=Object.freeze(new l(0,0,0,0));static HALF=Object.freeze(new l(.5,.5,.5,.5));static ONE=Object.freeze(new l(1,1,1,1))};var To=new k,os=new y,Ts=new y,Es=new y,il=new y,N=class l{data=new Float32Array(16);constructor(){this.data[0]=this.data[5]=this.data[10]=this.data[15]=1}static _getPerspectiveHalfSize(e,t,s,r,i){i?(e.x=r*Math.tan(t*Math.PI/360),e.y=e.x/s):(e.y=r*Math.tan(t*Math.PI/360),e.x=e.y*s)}add2(e,t){let s=e.data,r=t.data,i=this.data;return i[0]=s[0]+r[0],i[1]=s[1]+r[1],i[2]=s[2]+r[2],i[3]=s[3]+r[3],i[4]=s[4]+r[4],i[5]=s[5]+r[5],i[6]=s[6]+r[6],i[7]=s[7]+r[7],i[8]=s[8]+r[8],i[9]=s[9]+r[9],i[10]=s[10]+r[10],i[11]=s[11]+r[11],i[12]=s[12]+r[12],i[13]=s[13]+r[13],i[14]=s[14]+r[14],i[15]=s[15]+r[15],this}add(e){return this.add2(this,e)}clone(){let e=this.constructor;return new e().copy(this)}copy(e){let t=e.data,s=this.data;return s[0]=t[0],s[1]=t[1],s[2]=t[2],s[3]=t[3],s[4]=t[4],s[5]=t[5],s[6]=t[6],s[7]=t[7],s[8]=t[8],s[9]=t[9],s[10]=t[10],s[11]=t[11],s[12]=t[12],s[13]=t[13],s[14]=t[14],s[15]=t[15],this}equals(e){let t=this.data,s=e.data;return t[0]===s[0]&&t[1]===s[1]&&t[2]===s[2]&&t[3]===s[3]&&t[4]===s[4]&&t[5]===s[5]&&t[6]===s[6]&&t[7]===s[7]&&t[8]===s[8]&&t[9]===s[9]&&t[10]===s[10]&&t[11]===s[11]&&t[12]===s[12]&&t[13]===s[13]&&t[14]===s[14]&&t[15]===s[15]}isIdentity(){let e=this.data;return e[0]===1&&e[1]===0&&e[2]===0&&e[3]===0&&e[4]===0&&e[5]===1&&e[6]===0&&e[7]===0&&e[8]===0&&e[9]===0&&e[10]===1&&e[11]===0&&e[12]===0&&e[13]===0&&e[14]===0&&e[15]===1}mul2(e,t){let s=e.data,r=t.data,i=this.data,a=s[0],o=s[1],n=s[2],c=s[3],h=s[4],d=s[5],f=s[6],u=s[7],m=s[8],_=s[9],p=s[10],g=s[11],T=s[12],S=s[13],x=s[14],C=s[15],E,v,A,D;return E=r[0],v=r[1],A=r[2],D=r[3],i[0]=a*E+h*v+m*A+T*D,i[1]=o*E+d*v+_*A+S*D,i[2]=n*E+f*v+p*A+x*D,i[3]=c*E+u*v+g*A+C*D,E=r[4],v=r[5],A=r[6],D=r[7],i[4]=a*E+h*v+m*A+T*D,i[5]=o*E+d*v+_*A+S*D,i[6]=n*E+f*v+p*A+x*D,i[7]=c*E+u*v+g*A+C*D,E=r[8],v=r[9],A=r[10],D=r[11],i[8]=a*E+h*v+m*A+T*D,i[9]=o*E+d*v+_*A+S*D,i[10]=n*E+f*v+p*A+x*D,i[11]=c*E+u*v+g*A+C*D,E=r[12],v=r[13],A=r[14],D=r[15],i[12]=a*E+h*v+m*A+T*D,i[13]=o*E+d*v+_*A+S*D,i[14]=n*E+f*v+p*A+x*D,i[15]=c*E+u*v+g*A+C*D,this}mulAffine2(e,t){let s=e.data,r=t.data,i=this.data,a=s[0],o=s[1],n=s[2],c=s[4],h=s[5],d=s[6],f=s[8],u=s[9],m=s[10],_=s[12],p=s[13],g=s[14],T,S,x;return T=r[0],S=r[1],x=r[2],i[0]=a*T+c*S+f*x,i[1]=o*T+h*S+u*x,i[2]=n*T+d*S+m*x,i[3]=0,T=r[4],S=r[5],x=r[6],i[4]=a*T+c*S+f*x,i[5]=o*T+h*S+u*x,i[6]=n*T+d*S+m*x,i[7]=0,T=r[8],S=r[9],x=r[10],i[8]=a*T+c*S+f*x,i[9]=o*T+h*S+u*x,i[10]=n*T+d*S+m*x,i[11]=0,T=r[12],S=r[13],x=r[14],i[12]=a*T+c*S+f*x+_,i[13]=o*T+h*S+u*x+p,i[14]=n*T+d*S+m*x+g,i[15]=1,this}mul(e){return this.mul2(this,e)}transformPoint(e,t=new y){let s=this.data,{x:r,y:i,z:a}=e;return t.x=r*s[0]+i*s[4]+a*s[8]+s[12],t.y=r*s[1]+i*s[5]+a*s[9]+s[13],t.z=r*s[2]+i*s[6]+a*s[10]+s[14],t}transformVector(e,t=new y){let s=this.data,{x:r,y:i,z:a}=e;return t.x=r*s[0]+i*s[4]+a*s[8],t.y=r*s[1]+i*s[5]+a*s[9],t.z=r*s[2]+i*s[6]+a*s[10],t}transformVec4(e,t=new ne){let s=this.data,{x:r,y:i,z:a,w:o}=e;return t.x=r*s[0]+i*s[4]+a*s[8]+o*s[12],t.y=r*s[1]+i*s[5]+a*s[9]+o*s[13],t.z=r*s[2]+i*s[6]+a*s[10]+o*s[14],t.w=r*s[3]+i*s[7]+a*s[11]+o*s[15],t}setLookAt(e,t,s){Es.sub2(e,t).normalize(),Ts.copy(s).normalize(),os.cross(Ts,Es).normalize(),Ts.cross(Es,os);let r=this.data;return r[0]=os.x,r[1]=os.y,r[2]=os.z,r[3]=0,r[4]=Ts.x,r[5]=Ts.y,r[6]=Ts.z,r[7]=0,r[8]=Es.x,r[9]=Es.y,r[10]=Es.z,r[11]=0,r[12]=e.x,r[13]=e.y,r[14]=e.z,r[15]=1,this}setFrustum(e,t,s,r,i,a){let o=2*i,n=t-e,c=r-s,h=a-i,d=this.data;return d[0]=o/n,d[1]=0,d[2]=0,d[3]=0,d[4]=0,d[5]=o/c,d[6]=0,d[7]=0,d[8]=(t+e)/n,d[9]=(r+s)/c,d[10]=(-a-i)/h,d[11]=-1,d[12]=0,d[13]=0,d[14]=-o*a/h,d[15]=0,this}setPerspective(e,t,s,r,i){return l._getPerspectiveHalfSize(To,e,t,s,i),this.setFrustum(-To.x,To.x,-To.y,To.y,s,r)}setOrtho(e,t,s,r,i,a){let o=this.data;return o[0]=2/(t-e),o[1]=0,o[2]=0,o[3]=0,o[4]=0,o[5]=2/(r-s),o[6]=0,o[7]=0,o[8]=0,o[9]=0,o[10]=-2/(a-i),o[11]=0,o[12]=-(t+e)/(t-e),o[13]=-(r+s)/(r-s),o[14]=-(a+i)/(a-i),o[15]=1,this}setFromAxisAngle(e,t){t*=O.DEG_TO_RAD;let{x:s,y:r,z:i}=e,a=Math.cos(t),o=Math.sin(t),n=1-a,c=n*s,h=n*r,d=this.data;return d[0]=c*s+a,d[1]=c*r+o*i,d[2]=c*i-o*r,d[3]=0,d[4]=c*r-o*i,d[5]=h*r+a,d[6]=h*i+o*s,d[7]=0,d[8]=c*i+o*r,d[9]=h*i-s*o,d[10]=n*i*i+a,d[11]=0,d[12]=0,d[13]=0,d[14]=0,d[15]=1,this}setTranslate(e,t,s){let r=this.data;return r[0]=1,r[1]=0,r[2]=0,r[3]=0,r[4]=0,r[5]=1,r[6]=0,r[7]=0,r[8]=0,r[9]=0,r[10]=1,r[11]=0,r[12]=e,r[13]=t,r[14]=s,r[15]=1,this}setScale(e,t,s){let r=this.data;return r[0]=e,r[1]=0,r[2]=0,r[3]=0,r[4]=0,r[5]=t,r[6]=0,r[7]=0,r[8]=0,r[9]=0,r[10]=s,r[11]=0,r[12]=0,r[13]=0,r[14]=0,r[15]=1,this}setViewport(e,t,s,r){let i=this.data;return i[0]=s*.5,i[1]=0,i[2]=0,i[3]=0,i[4]=0,i[5]=r*.5,i[6]=0,i[7]=0,i[8]=0,i[9]=0,i[10]=.5,i[11]=0,i[12]=e+s*.5,i[13]=t+r*.5,i[14]=.5,i[15]=1,this}setReflection(e,t){let s=e.x,r=e.y,i=e.z,a=this.data;return a[0]=1-2*s*s,a[1]=-2*s*r,a[2]=-2*s*i,a[3]=0,a[4]=-2*s*r,a[5]=1-2*r*r,a[6]=-2*r*i,a[7]=0,a[8]=-2*s*i,a[9]=-2*r*i,a[10]=1-2*i*i,a[11]=0,a[12]=-2*s*t,a[13]=-2*r*t,a[14]=-2*i*t,a[15]=1,this}invert(e=this){let t=e.data,s=t[0],r=t[1],i=t[2],a=t[3],o=t[4],n=t[5],c=t[6],h=t[7],d=t[8],f=t[9],u=t[10],m=t[11],_=t[12],p=t[13],g=t[14],T=t[15],S=s*n-r*o,x=s*c-i*o,C=s*h-a*o,E=r*c-i*n,v=r*h-a*n,A=i*h-a*c,D=d*p-f*_,R=d*g-u*_,w=d*T-m*_,M=f*g-u*p,P=f*T-m*p,L=u*T-m*g,G=S*L-x*P+C*M+E*w-v*R+A*D;if(G===0)this.setIdentity();else{let U=1/G,F=this.data;F[0]=(n*L-c*P+h*M)*U,F[1]=(-r*L+i*P-a*M)*U,F[2]=(p*A-g*v+T*E)*U,F[3]=(-f*A+u*v-m*E)*U,F[4]=(-o*L+c*w-h*R)*U,F[5]=(s*L-i*w+a*R)*U,F[6]=(-_*A+g*C-T*x)*U,F[7]=(d*A-u*C+m*x)*U,F[8]=(o*P-n*w+h*D)*U,F[9]=(-s*P+r*w-a*D)*U,F[10]=(_*v-p*C+T*S)*U,F[11]=(-d*v+f*C-m*S)*U,F[12]=(-o*M+n*R-c*D)*U,F[13]=(s*M-r*R+i*D)*U,F[14]=(-_*E+p*x-g*S)*U,F[15]=(d*E-f*x+u*S)*U}return this}set(e){let t=this.data;return t[0]=e[0],t[1]=e[1],t[2]=e[2],t[3]=e[3],t[4]=e[4],t[5]=e[5],t[6]=e[6],t[7]=e[7],t[8]=e[8],t[9]=e[9],t[10]=e[10],t[11]=e[11],t[12]=e[12],t[13]=e[13],t[14]=e[14],t[15]=e[15],this}setIdentity(){let e=this.data;return e[0]=1,e[1]=0,e[2]=0,e[3]=0,e[4]=0,e[5]=1,e[6]=0,e[7]=0,e[8]=0,e[9]=0,e[10]=1,e[11]=0,e[12]=0,e[13]=0,e[14]=0,e[15]=1,this}setTRS(e,t,s){let r=t.x,i=t.y,a=t.z,o=t.w,n=s.x,c=s.y,h=s.z,d=r+r,f=i+i,u=a+a,m=r*d,_=r*f,p=r*u,g=i*f,T=i*u,S=a*u,x=o*d,C=o*f,E=o*u,v=this.data;return v[0]=(1-(g+S))*n,v[1]=(_+E)*n,v[2]=(p-C)*n,v[3]=0,v[4]=(_-E)*c,v[5]=(1-(m+S))*c,v[6]=(T+x)*c,v[7]=0,v[8]=(p+C)*h,v[9]=(T-x)*h,v[10]=(1-(m+g))*h,v[11]=0,v[12]=e.x,v[13]=e.y,v[14]=e.z,v[15]=1,this}transpose(e=this){let t=e.data,s=this.data;if(t===s){let r;r=t[1],s[1]=t[4],s[4]=r,r=t[2],s[2]=t[8],s[8]=r,r=t[3],s[3]=t[12],s[12]=r,r=t[6],s[6]=t[9],s[9]=r,r=t[7],s[7]=t[13],s[13]=r,r=t[11],s[11]=t[14],s[14]=r}else s[0]=t[0],s[1]=t[4],s[2]=t[8],s[3]=t[12],s[4]=t[1],s[5]=t[5],s[6]=t[9],s[7]=t[13],s[8]=t[2],s[9]=t[6],s[10]=t[10],s[11]=t[14],s[12]=t[3],s[13]=t[7],s[14]=t[11],s[15]=t[15];return this}getTranslation(e=new y){return e.set(this.data[12],this.data[13],this.data[14])}getX(e=new y){return e.set(this.data[0],this.data[1],this.data[2])}getY(e=new y){return e.set(this.data[4],this.data[5],this.data[6])}getZ(e=new y){return e.set(this.data[8],this.data[9],this.data[10])}getScale(e=new y){return this.getX(os),this.getY(Ts),this.getZ(Es),e.set(os.length(),Ts.length(),Es.length()),e}get scaleSign(){return this.getX(os),this.getY(Ts),this.getZ(Es),os.cross(os,Ts),os.dot(Es)<0?-1:1}setFromEulerAngles(e,t,s){e*=O.DEG_TO_RAD,t*=O.DEG_TO_RAD,s*=O.DEG_TO_RAD;let r=Math.sin(-e),i=Math.cos(-e),a=Math.sin(-t),o=Math.cos(-t),n=Math.sin(-s),c=Math.cos(-s),h=this.data;return h[0]=o*c,h[1]=-o*n,h[2]=a,h[3]=0,h[4]=i*n+c*r*a,h[5]=i*c-r*a*n,h[6]=-o*r,h[7]=0,h[8]=r*n-i*c*a,h[9]=c*r+i*a*n,h[10]=i*o,h[11]=0,h[12]=0,h[13]=0,h[14]=0,h[15]=1,this}getEulerAngles(e=new y){this.getScale(il);let t=il.x,s=il.y,r=il.z;if(t===0||s===0||r===0)return e.set(0,0,0);let i=this.data,a=Math.asin(-i[2]/t),o=Math.PI*.5,n,c;return a<o?a>-o?(n=Math.atan2(i[6]/s,i[10]/r),c=Math.atan2(i[1]/t,i[0]/t)):(c=0,n=-Math.atan2(i[4]/s,i[5]/s)):(c=0,n=Math.atan2(i[4]/s,i[5]/s)),e.set(n,a,c).mulScalar(O.RAD_TO_DEG)}toString(){return`[${this.data.join(", ")}]`}static IDENTITY=Object.freeze(new l);static ZERO=Object.freeze(new l().set([0,0,0,0,0,0,0,0,0,0,0,0,0,0,0,0]))};var fe=class l{x;y;z;w;constructor(e=0,t=0,s=0,r=1){e.length===4?(this.x=e[0],this.y=e[1],this.z=e[2],this.w=e[3]):(this.x=e,this.y=t,this.z=s,this.w=r)}clone(){let e=this.constructor;return new e(this.x,this.y,this.z,this.w)}conjugate(e=this){return this.x=e.x*-1,this.y=e.y*-1,this.z=e.z*-1,this.w=e.w,this}copy(e){return this.x=e.x,this.y=e.y,this.z=e.z,this.w=e.w,this}dot(e){return this.x*e.x+this.y*e.y+this.z*e.z+this.w*e.w}equals(e){return this.x===e.x&&this.y===e.y&&this.z===e.z&&this.w===e.w}equalsApprox(e,t=1e-6){return Math.abs(this.x-e.x)<t&&Math.abs(this.y-e.y)<t&&Math.abs(this.z-e.z)<t&&Math.abs(this.w-e.w)<t}getAxisAngle(e){let t=Math.acos(this.w)*2,s=Math.sin(t/2);return s!==0?(e.x=this.x/s,e.y=this.y/s,e.z=this.z/s,(e.x<0||e.y<0||e.z<0)&&(e.x*=-1,e.y*=-1,e.z*=-1,t*=-1)):(e.x=1,e.y=0,e.z=0),t*O.RAD_TO_DEG}getEulerAngles(e=new y){let t,s,r,i=this.x,a=this.y,o=this.z,n=this.w,c=2*(n*a-i*o);return c<=-.99999?(t=2*Math.atan2(i,n),s=-Math.PI/2,r=0):c>=.99999?(t=2*Math.atan2(i,n),s=Math.PI/2,r=0):(t=Math.atan2(2*(n*i+a*o),1-2*(i*i+a*a)),s=Math.asin(c),r=Math.atan2(2*(n*o+i*a),1-2*(a*a+o*o))),e.set(t,s,r).mulScalar(O.RAD_TO_DEG)}invert(e=this){return this.conjugate(e).normalize()}length(){return Math.sqrt(this.x*this.x+this.y*this.y+this.z*this.z+this.w*this.w)}lengthSq(){return this.x*this.x+this.y*this.y+this.z*this.z+this.w*this.w}lerp(e,t,s){let r=(1-s)*(e.dot(t)<0?-1:1);return this.x=e.x*r+t.x*s,this.y=e.y*r+t.y*s,this.z=e.z*r+t.z*s,this.w=e.w*r+t.w*s,this.normalize()}mul(e){let t=this.x,s=this.y,r=this.z,i=this.w,a=e.x,o=e.y,n=e.z,c=e.w;return this.x=i*a+t*c+s*n-r*o,this.y=i*o+s*c+r*a-t*n,this.z=i*n+r*c+t*o-s*a,this.w=i*c-t*a-s*o-r*n,this}mulScalar(e,t=this){return this.x=t.x*e,this.y=t.y*e,this.z=t.z*e,this.w=t.w*e,this}mul2(e,t){let s=e.x,r=e.y,i=e.z,a=e.w,o=t.x,n=t.y,c=t.z,h=t.w;return this.x=a*o+s*h+r*c-i*n,this.y=a*n+r*h+i*o-s*c,this.z=a*c+i*h+s*n-r*o,this.w=a*h-s*o-r*n-i*c,this}normalize(e=this){let t=e.length();return t===0?(this.x=this.y=this.z=0,this.w=1):(t=1/t,this.x=e.x*t,this.y=e.y*t,this.z=e.z*t,this.w=e.w*t),this}set(e,t,s,r){return this.x=e,this.y=t,this.z=s,this.w=r,this}setFromAxisAngle(e,t){t*=.5*O.DEG_TO_RAD;let s=Math.sin(t),r=Math.cos(t);return this.x=s*e.x,this.y=s*e.y,this.z=s*e.z,this.w=r,this}setFromEulerAngles(e,t,s){if(e instanceof y){let d=e;e=d.x,t=d.y,s=d.z}let r=.5*O.DEG_TO_RAD;e*=r,t*=r,s*=r;let i=Math.sin(e),a=Math.cos(e),o=Math.sin(t),n=Math.cos(t),c=Math.sin(s),h=Math.cos(s);return this.x=i*n*h-a*o*c,this.y=a*o*h+i*n*c,this.z=a*n*c-i*o*h,this.w=a*n*h+i*o*c,this}setFromMat4(e){let t=e.data,s=t[0],r=t[1],i=t[2],a=t[4],o=t[5],n=t[6],c=t[8],h=t[9],d=t[10];s*(o*d-n*h)-r*(a*d-n*c)+i*(a*h-o*c)<0&&(s=-s,r=-r,i=-i);let u;return u=s*s+r*r+i*i,u===0?this.set(0,0,0,1):(u=1/Math.sqrt(u),s*=u,r*=u,i*=u,u=a*a+o*o+n*n,u===0?this.set(0,0,0,1):(u=1/Math.sqrt(u),a*=u,o*=u,n*=u,u=c*c+h*h+d*d,u===0?this.set(0,0,0,1):(u=1/Math.sqrt(u),c*=u,h*=u,d*=u,d<0?s>o?this.set(1+s-o-d,r+a,c+i,n-h):this.set(r+a,1-s+o-d,n+h,c-i):s<-o?this.set(c+i,n+h,1-s-o+d,r-a):this.set(n-h,c-i,r-a,1+s+o+d),this.mulScalar(1/this.length()))))}setFromDirections(e,t){let s=1+e.dot(t);return s<Number.EPSILON?Math.abs(e.x)>Math.abs(e.y)?(this.x=-e.z,this.y=0,this.z=e.x,this.w=0):(this.x=0,this.y=-e.z,this.z=e.y,this.w=0):(this.x=e.y*t.z-e.z*t.y,this.y=e.z*t.x-e.x*t.z,this.z=e.x*t.y-e.y*t.x,this.w=s),this.normalize()}slerp(e,t,s){let r=e.x,i=e.y,a=e.z,o=e.w,n=t.x,c=t.y,h=t.z,d=t.w,f=o*d+r*n+i*c+a*h;if(f<0&&(d=-d,n=-n,c=-c,h=-h,f=-f),Math.abs(f)>=1)return this.w=o,this.x=r,this.y=i,this.z=a,this;let u=Math.acos(f),m=Math.sqrt(1-f*f);if(Math.abs(m)<.001)return this.w=o*.5+d*.5,this.x=r*.5+n*.5,this.y=i*.5+c*.5,this.z=a*.5+h*.5,this;let _=Math.sin((1-s)*u)/m,p=Math.sin(s*u)/m;return this.w=o*_+d*p,this.x=r*_+n*p,this.y=i*_+c*p,this.z=a*_+h*p,this}transformVector(e,t=new y){let s=e.x,r=e.y,i=e.z,a=this.x,o=this.y,n=this.z,c=this.w,h=c*s+o*i-n*r,d=c*r+n*s-a*i,f=c*i+a*r-o*s,u=-a*s-o*r-n*i;return t.x=h*c+u*-a+d*-n-f*-o,t.y=d*c+u*-o+f*-a-h*-n,t.z=f*c+u*-n+h*-o-d*-a,t}fromArray(e,t=0){return this.x=e[t]??this.x,this.y=e[t+1]??this.y,this.z=e[t+2]??this.z,this.w=e[t+3]??this.w,this}toString(){return`[${this.x}, ${this.y}, ${this.z}, ${this.w}]`}toArray(e=[],t=0){return e[t]=this.x,e[t+1]=this.y,e[t+2]=this.z,e[t+3]=this.w,e}static IDENTITY=Object.freeze(new l(0,0,0,1));static ZERO=Object.freeze(new l(0,0,0,0))};var ki=new y,Gi=new y,h_=new y,d_=new y,wA=new y,J=class l{center=new y;halfExtents=new y(.5,.5,.5);_min=new y;_max=new y;constructor(e,t){e&&this.center.copy(e),t&&this.halfExtents.copy(t)}add(e){let t=this.center,s=t.x,r=t.y,i=t.z,a=this.halfExtents,o=a.x,n=a.y,c=a.z,h=s-o,d=s+o,f=r-n,u=r+n,m=i-c,_=i+c,p=e.center,g=p.x,T=p.y,S=p.z,x=e.halfExtents,C=x.x,E=x.y,v=x.z,A=g-C,D=g+C,R=T-E,w=T+E,M=S-v,P=S+v;A<h&&(h=A),D>d&&(d=D),R<f&&(f=R),w>u&&(u=w),M<m&&(m=M),P>_&&(_=P),t.x=(h+d)*.5,t.y=(f+u)*.5,t.z=(m+_)*.5,a.x=(d-h)*.5,a.y=(u-f)*.5,a.z=(_-m)*.5}copy(e){this.center.copy(e.center),this.halfExtents.copy(e.halfExtents)}clone(){return new l(this.center,this.halfExtents)}equals(e){return this.center.equals(e.center)&&this.halfExtents.equals(e.halfExtents)}intersects(e){let t=this.getMax(),s=this.getMin(),r=e.getMax(),i=e.getMin();return s.x<=r.x&&t.x>=i.x&&s.y<=r.y&&t.y>=i.y&&s.z<=r.z&&t.z>=i.z}_intersectsRay(e,t){let s=ki.copy(this.getMin()).sub(e.origin),r=Gi.copy(this.getMax()).sub(e.origin),i=e.direction;i.x===0?(s.x=s.x<0?-Number.MAX_VALUE:Number.MAX_VALUE,r.x=r.x<0?-Number.MAX_VALUE:Number.MAX_VALUE):(s.x/=i.x,r.x/=i.x),i.y===0?(s.y=s.y<0?-Number.MAX_VALUE:Number.MAX_VALUE,r.y=r.y<0?-Number.MAX_VALUE:Number.MAX_VALUE):(s.y/=i.y,r.y/=i.y),i.z===0?(s.z=s.z<0?-Number.MAX_VALUE:Number.MAX_VALUE,r.z=r.z<0?-Number.MAX_VALUE:Number.MAX_VALUE):(s.z/=i.z,r.z/=i.z);let a=h_.set(Math.min(s.x,r.x),Math.min(s.y,r.y),Math.min(s.z,r.z)),o=d_.set(Math.max(s.x,r.x),Math.max(s.y,r.y),Math.max(s.z,r.z)),n=Math.min(Math.min(o.x,o.y),o.z),c=Math.max(Math.max(a.x,a.y),a.z),h=n>=c&&c>=0;return h&&t.copy(e.direction).mulScalar(c).add(e.origin),h}_fastIntersectsRay(e){let t=ki,s=Gi,r=h_,i=d_,a=wA,o=e.direction;return t.sub2(e.origin,this.center),i.set(Math.abs(t.x),Math.abs(t.y),Math.abs(t.z)),r.mul2(t,o),!(i.x>this.halfExtents.x&&r.x>=0||i.y>this.halfExtents.y&&r.y>=0||i.z>this.halfExtents.z&&r.z>=0||(a.set(Math.abs(o.x),Math.abs(o.y),Math.abs(o.z)),s.cross(o,t),s.set(Math.abs(s.x),Math.abs(s.y),Math.abs(s.z)),s.x>this.halfExtents.y*a.z+this.halfExtents.z*a.y)||s.y>this.halfExtents.x*a.z+this.halfExtents.z*a.x||s.z>this.halfExtents.x*a.y+this.halfExtents.y*a.x)}intersectsRay(e,t){return t?this._intersectsRay(e,t):this._fastIntersectsRay(e)}setMinMax(e,t){this.center.add2(t,e).mulScalar(.5),this.halfExtents.sub2(t,e).mulScalar(.5)}getMin(){return this._min.copy(this.center).sub(this.halfExtents)}getMax(){return this._max.copy(this.center).add(this.halfExtents)}containsPoint(e){let t=this.center,s=this.halfExtents;return!(e.x<t.x-s.x||e.x>t.x+s.x||e.y<t.y-s.y||e.y>t.y+s.y||e.z<t.z-s.z||e.z>t.z+s.z)}closestPoint(e,t=new y){let s=this.center,r=this.halfExtents;return t.set(Math.max(s.x-r.x,Math.min(e.x,s.x+r.x)),Math.max(s.y-r.y,Math.min(e.y,s.y+r.y)),Math.max(s.z-r.z,Math.min(e.z,s.z+r.z)))}setFromTransformedAabb(e,t,s=!1){let r=e.center,i=e.halfExtents,a=t.data,o=a[0],n=a[4],c=a[8],h=a[1],d=a[5],f=a[9],u=a[2],m=a[6],_=a[10];if(s){let p=o*o+n*n+c*c;if(p>0){let g=1/Math.sqrt(p);o*=g,n*=g,c*=g}if(p=h*h+d*d+f*f,p>0){let g=1/Math.sqrt(p);h*=g,d*=g,f*=g}if(p=u*u+m*m+_*_,p>0){let g=1/Math.sqrt(p);u*=g,m*=g,_*=g}}this.center.set(a[12]+o*r.x+n*r.y+c*r.z,a[13]+h*r.x+d*r.y+f*r.z,a[14]+u*r.x+m*r.y+_*r.z),this.halfExtents.set(Math.abs(o)*i.x+Math.abs(n)*i.y+Math.abs(c)*i.z,Math.abs(h)*i.x+Math.abs(d)*i.y+Math.abs(f)*i.z,Math.abs(u)*i.x+Math.abs(m)*i.y+Math.abs(_)*i.z)}static computeMinMax(e,t,s,r=e.length/3){if(r>0){let i=e[0],a=e[1],o=e[2],n=i,c=a,h=o,d=r*3;for(let f=3;f<d;f+=3){let u=e[f],m=e[f+1],_=e[f+2];u<i&&(i=u),m<a&&(a=m),_<o&&(o=_),u>n&&(n=u),m>c&&(c=m),_>h&&(h=_)}t.set(i,a,o),s.set(n,c,h)}}compute(e,t){l.computeMinMax(e,ki,Gi,t),this.setMinMax(ki,Gi)}intersectsBoundingSphere(e){return this._distanceToBoundingSphereSq(e)<=e.radius*e.radius}_distanceToBoundingSphereSq(e){let t=this.getMin(),s=this.getMax(),r=0,i=["x","y","z"];for(let a=0;a<3;++a){let o=0,n=e.center[i[a]],c=t[i[a]],h=s[i[a]],d=0;n<c&&(d=c-n,o+=d*d),n>h&&(d=n-h,o+=d*d),r+=o}return r}_expand(e,t){ki.add2(this.getMin(),e),Gi.add2(this.getMax(),t),this.setMinMax(ki,Gi)}};var al=new y,MA=new y,ol=class{center;radius;constructor(e=new y,t=.5){this.center=e,this.radius=t}containsPoint(e){let t=al.sub2(e,this.center).lengthSq(),s=this.radius;return t<s*s}intersectsRay(e,t){let s=al.copy(e.origin).sub(this.center),r=s.dot(MA.copy(e.direction).normalize()),i=s.dot(s)-this.radius*this.radius;if(i>0&&r>0)return!1;let a=r*r-i;if(a<0)return!1;let o=Math.abs(-r-Math.sqrt(a));return t&&t.copy(e.direction).mulScalar(o).add(e.origin),!0}intersectsBoundingSphere(e){al.sub2(e.center,this.center);let t=e.radius+this.radius;return al.lengthSq()<=t*t}};var Ys=class{normal=new y;distance;constructor(e=y.UP,t=0){this.normal.copy(e),this.distance=t}clone(){let e=this.constructor;return new e().copy(this)}copy(e){return this.normal.copy(e.normal),this.distance=e.distance,this}intersectsLine(e,t,s){let r=this.distance,i=this.normal.dot(e)+r,a=this.normal.dot(t)+r,o=i/(i-a),n=o>=0&&o<=1;return n&&s&&s.lerp(e,t,o),n}intersectsRay(e,t){let s=this.normal.dot(e.direction);if(s===0)return!1;let r=-(this.normal.dot(e.origin)+this.distance)/s;return r>=0&&t&&t.copy(e.direction).mulScalar(r).add(e.origin),r>=0}normalize(){let e=1/this.normal.length();return this.normal.mulScalar(e),this.distance*=e,this}set(e,t,s,r){return this.normal.set(e,t,s),this.distance=r,this}setFromPointNormal(e,t){return this.normal.copy(t),this.distance=-this.normal.dot(e),this}};var Eo=new y,nl=new y,ll=new y,cl=new y,hl=[new Ys,new Ys,new Ys,new Ys,new Ys,new Ys];function LA(l,e,t,s){Eo.cross(e.normal,t.normal);let r=l.normal.dot(Eo);if(Math.abs(r)<1e-6)return!1;nl.cross(t.normal,l.normal),ll.cross(l.normal,e.normal);let i=-1/r;return s.set((l.distance*Eo.x+e.distance*nl.x+t.distance*ll.x)*i,(l.distance*Eo.y+e.distance*nl.y+t.distance*ll.y)*i,(l.distance*Eo.z+e.distance*nl.z+t.distance*ll.z)*i),isFinite(s.x)&&isFinite(s.y)&&isFinite(s.z)}var ai=class{planeData=new Float32Array(24);constructor(){}get planes(){return[]}clone(){let e=this.constructor;return new e().copy(this)}copy(e){return this.planeData.set(e.planeData),this}getPlane(e,t){let s=this.planeData,r=e*4;return t.normal.set(s[r],s[r+1],s[r+2]),t.distance=s[r+3],t}setPlane(e,t){let{normal:s,distance:r}=t;return this._setPlane(e,s.x,s.y,s.z,r),this}_setPlane(e,t,s,r,i){let a=1/Math.sqrt(t*t+s*s+r*r),o=this.planeData,n=e*4;o[n]=t*a,o[n+1]=s*a,o[n+2]=r*a,o[n+3]=i*a}setFromMat4(e){let t=e.data,s=t[0],r=t[1],i=t[2],a=t[3],o=t[4],n=t[5],c=t[6],h=t[7],d=t[8],f=t[9],u=t[10],m=t[11],_=t[12],p=t[13],g=t[14],T=t[15];this._setPlane(0,a-s,h-o,m-d,T-_),this._setPlane(1,a+s,h+o,m+d,T+_),this._setPlane(2,a+r,h+n,m+f,T+p),this._setPlane(3,a-r,h-n,m-f,T-p),this._setPlane(4,a-i,h-c,m-u,T-g),this._setPlane(5,a+i,h+c,m+u,T+g)}containsPoint(e){let t=this.planeData,{x:s,y:r,z:i}=e;for(let a=0;a<24;a+=4)if(t[a]*s+t[a+1]*r+t[a+2]*i+t[a+3]<=0)return!1;return!0}add(e){let t=this.planeData;for(let s=0;s<6;s++)e.getPlane(s,hl[s]);for(let s=4;s<=5;s++)for(let r=0;r<=1;r++)for(let i=2;i<=3;i++)if(LA(hl[s],hl[r],hl[i],cl))for(let a=0;a<24;a+=4){let o=t[a]*cl.x+t[a+1]*cl.y+t[a+2]*cl.z+t[a+3];o<0&&(t[a+3]-=o)}return this}containsSphere(e){let t=this.planeData,{center:s,radius:r}=e,{x:i,y:a,z:o}=s,n=0;for(let c=0;c<24;c+=4){let h=t[c]*i+t[c+1]*a+t[c+2]*o+t[c+3];if(h<=-r)return 0;h>r&&n++}return n===6?2:1}containsAabb(e){let t=this.planeData,{center:s,halfExtents:r}=e,{x:i,y:a,z:o}=s,n=r.x,c=r.y,h=r.z;for(let d=0;d<24;d+=4){let f=t[d],u=t[d+1],m=t[d+2],_=Math.abs(f)*n+Math.abs(u)*c+Math.abs(m)*h;if(f*i+u*a+m*o+t[d+3]<=-_)return!1}return!0}};var pt="bottom",yo="native";var f_=[1,2,4],Gf=0,Vf=1,zf=2,Sl=3,Tl=4,El=5,Co=6,Re=7,Hf=8,Wf=9,vo=10,yl=11,ge=12,Cl=13,We=14,lt=15,Lt=16,oi=17,Vi=18,Xf=19,vr=20,Yf=21,jf=22,qf=23,xo=24,Ao=25,$f=26,Kf=27,Zf=28,Qf=29,Jf=30,eu=31,vl=32,Ro=33,xl=34,zi=35,Al=36,xt=37,Rl=38,tu=39,Pl=40,Dl=41,Il=42,Hi=43,wl=44,su=45,Ml=46,_t=47,Ll=48,Je=49,xr=50,Wi=51,Po=52,Do=53,dl=54,fl=55,ul=56,ml=61,pl=62,_l=63,ru=64,iu=65,au=66,ou=67,gl=68,js=69,Xi=70,bl=71,Fl=72,Ol=73,Nl=74,Bl=75,rt=new Map([[Gf,{name:"A8",size:1,ldr:!0}],[Po,{name:"R8",size:1,ldr:!0,msaa:!0,msaaResolve:!0}],[Vf,{name:"L8",size:1,ldr:!0}],[zf,{name:"LA8",size:2,ldr:!0}],[Do,{name:"RG8",size:2,ldr:!0,msaa:!0,msaaResolve:!0}],[Sl,{name:"RGB565",size:2,ldr:!0}],[Tl,{name:"RGBA5551",size:2,ldr:!0}],[El,{name:"RGBA4",size:2,ldr:!0}],[Co,{name:"RGB8",size:4,ldr:!0,msaa:!0,msaaResolve:!0}],[Re,{name:"RGBA8",size:4,ldr:!0,srgbFormat:vr,msaa:!0,msaaResolve:!0}],[xr,{name:"R16F",size:2,msaa:!0,msaaResolve:!0}],[Wi,{name:"RG16F",size:4,msaa:!0,msaaResolve:!0}],[yl,{name:"RGB16F",size:8}],[ge,{name:"RGBA16F",size:8,msaa:!0,msaaResolve:!0}],[Cl,{name:"RGB32F",size:16}],[We,{name:"RGBA32F",size:16}],[lt,{name:"R32F",size:4,msaa:!0}],[Xi,{name:"RG32F",size:8}],[bl,{name:"RGB9E5",size:4}],[Fl,{name:"RG8S",size:2}],[Ol,{name:"RGBA8S",size:4}],[Nl,{name:"RGB10A2",size:4,msaa:!0,msaaResolve:!0}],[Bl,{name:"RGB10A2U",size:4,isUint:!0,msaa:!0}],[Lt,{name:"DEPTH",size:4,msaa:!0}],[js,{name:"DEPTH16",size:2,msaa:!0}],[oi,{name:"DEPTHSTENCIL",size:4,msaa:!0}],[Vi,{name:"111110F",size:4,msaa:!0,msaaResolve:!0}],[Xf,{name:"SRGB8",size:4,ldr:!0,srgb:!0}],[vr,{name:"SRGBA8",size:4,ldr:!0,srgb:!0,msaa:!0,msaaResolve:!0}],[eu,{name:"BGRA8",size:4,ldr:!0,msaa:!0,msaaResolve:!0}],[ru,{name:"SBGRA8",size:4,ldr:!0,srgb:!0,msaa:!0,msaaResolve:!0}],[Hf,{name:"DXT1",blockSize:8,ldr:!0,srgbFormat:dl}],[Wf,{name:"DXT3",blockSize:16,ldr:!0,srgbFormat:fl}],[vo,{name:"DXT5",blockSize:16,ldr:!0,srgbFormat:ul}],[Yf,{name:"ETC1",blockSize:8,ldr:!0}],[jf,{name:"ETC2_RGB",blockSize:8,ldr:!0,srgbFormat:ml}],[qf,{name:"ETC2_RGBA",blockSize:16,ldr:!0,srgbFormat:pl}],[xo,{name:"PVRTC_2BPP_RGB_1",ldr:!0,blockSize:8}],[Ao,{name:"PVRTC_2BPP_RGBA_1",ldr:!0,blockSize:8}],[$f,{name:"PVRTC_4BPP_RGB_1",ldr:!0,blockSize:8}],[Kf,{name:"PVRTC_4BPP_RGBA_1",ldr:!0,blockSize:8}],[Zf,{name:"ASTC_4x4",blockSize:16,ldr:!0,srgbFormat:_l}],[Qf,{name:"ATC_RGB",blockSize:8,ldr:!0}],[Jf,{name:"ATC_RGBA",blockSize:16,ldr:!0}],[iu,{name:"BC6H_RGBF",blockSize:16}],[au,{name:"BC6H_RGBUF",blockSize:16}],[ou,{name:"BC7_RGBA",blockSize:16,ldr:!0,srgbFormat:gl}],[dl,{name:"DXT1_SRGB",blockSize:8,ldr:!0,srgb:!0}],[fl,{name:"DXT3_SRGBA",blockSize:16,ldr:!0,srgb:!0}],[ul,{name:"DXT5_SRGBA",blockSize:16,ldr:!0,srgb:!0}],[ml,{name:"ETC2_SRGB",blockSize:8,ldr:!0,srgb:!0}],[pl,{name:"ETC2_SRGBA",blockSize:16,ldr:!0,srgb:!0}],[_l,{name:"ASTC_4x4_SRGB",blockSize:16,ldr:!0,srgb:!0}],[gl,{name:"BC7_SRGBA",blockSize:16,ldr:!0,srgb:!0}],[vl,{name:"R8I",size:1,isInt:!0,msaa:!0}],[xl,{name:"R16I",size:2,isInt:!0,msaa:!0}],[Al,{name:"R32I",size:4,isInt:!0}],[Rl,{name:"RG8I",size:2,isInt:!0,msaa:!0}],[Pl,{name:"RG16I",size:4,isInt:!0,msaa:!0}],[Il,{name:"RG32I",size:8,isInt:!0}],[wl,{name:"RGBA8I",size:4,isInt:!0,msaa:!0}],[Ml,{name:"RGBA16I",size:8,isInt:!0,msaa:!0}],[Ll,{name:"RGBA32I",size:16,isInt:!0}],[Ro,{name:"R8U",size:1,isUint:!0,msaa:!0}],[zi,{name:"R16U",size:2,isUint:!0,msaa:!0}],[xt,{name:"R32U",size:4,isUint:!0}],[tu,{name:"RG8U",size:2,isUint:!0,msaa:!0}],[Dl,{name:"RG16U",size:4,isUint:!0,msaa:!0}],[Hi,{name:"RG32U",size:8,isUint:!0}],[su,{name:"RGBA8U",size:4,isUint:!0,msaa:!0}],[_t,{name:"RGBA16U",size:8,isUint:!0,msaa:!0}],[Je,{name:"RGBA32U",size:16,isUint:!0}]]),u_=l=>rt.get(l)?.blockSize!==void 0,Yi=l=>rt.get(l)?.srgb===!0,qs=l=>{let e=rt.get(l);return e?.isInt===!0||e?.isUint===!0};var bA={sampler:"sampler2D",returnType:"vec4"},FA={sampler:"usampler2D",returnType:"uvec4"},OA={sampler:"isampler2D",returnType:"ivec4"},NA={textureType:"texture_2d<f32>",returnType:"vec4f"},BA={textureType:"texture_2d<u32>",returnType:"vec4u"},UA={textureType:"texture_2d<i32>",returnType:"vec4i"},ji=l=>{let e=rt.get(l);return e?.isUint?FA:e?.isInt?OA:bA},Io=l=>{let e=rt.get(l);return e?.isUint?BA:e?.isInt?UA:NA},nu=l=>rt.get(l)?.srgbFormat||l,m_=l=>{for(let[e,t]of rt)if(t.srgbFormat===l)return e;return l},p_=l=>{let e=rt.get(l);return!!(e?.ldr&&!e?.srgb)},Ul=l=>{switch(l){case lt:case Xi:case Cl:case We:return Float32Array;case Al:case Il:case Ll:return Int32Array;case xt:case Hi:case Je:case bl:case Nl:case Bl:return Uint32Array;case xl:case Pl:case Ml:return Int16Array;case zi:case Dl:case _t:case Sl:case Tl:case El:case xr:case Wi:case yl:case ge:return Uint16Array;case vl:case Rl:case wl:case Fl:case Ol:return Int8Array;default:return Uint8Array}},lu=0,wo=1;var $s=4;var le="POSITION",ys="NORMAL",ns="TANGENT",Xt="BLENDWEIGHT",Yt="BLENDINDICES",gt="COLOR",qi="TEXCOORD",$i="TEXCOORD0",Ki="TEXCOORD1",Zi="TEXCOORD2",Qi="TEXCOORD3",Ji="TEXCOORD4",ea="TEXCOORD5",ta="TEXCOORD6",sa="TEXCOORD7",kA="ATTR0",GA="ATTR1",VA="ATTR2",zA="ATTR3",HA="ATTR4",WA="ATTR5",XA="ATTR6",YA="ATTR7",cu="ATTR8",hu="ATTR9",jA="ATTR10",Mo="ATTR11",Lo="ATTR12",qA="ATTR13",bo="ATTR14",Ar="ATTR15",__=1,Rr=0;var kl=0;var Gl=2,At="default",Vl="rgbm",g_="rgbe",ra="rgbp",Fo="swizzleGGGR";var Ks="2d",ia="2d-array",aa="cube";var Oo="3d",ni=0,zl=1,S_=2,No=3,Bo=4,T_="none",Uo="cube",du="equirect",E_="octahedral",ce="glsl",q="wgsl",li=0,ci=1,hi=2,ko=3,pe=4,Qe=5,_e=6,y_=7,Zs=0,ct=1,b=2,ht=3,Z=4,Pe=5,ls=6,Rt=7,cs=8,Pr=9,Dr=10,Ir=11,di=12,Cs=13,Be=14,C_=15,v_=16,wr=17,x_=18,A_=19,R_=20,Mr=21,Lr=22,oa=23,Hl=24,P_=25,X=26,vs=27,xs=28,Pt=29,As=30,br=31,Fr=32,Rs=33,Or=34,Nr=35,Ps=36,Br=37,Ur=38,fi=39,na=40,la=41,D_=42,I_=43,w_=44,M_=45,L_=46,b_=47,F_=48,O_=49,Go=["bool","int","float","vec2","vec3","vec4","ivec2","ivec3","ivec4","bvec2","bvec3","bvec4","mat2","mat3","mat4","sampler2D","samplerCube","","sampler2DShadow","samplerCubeShadow","sampler3D","","","","","sampler2DArray","uint","uvec2","uvec3","uvec4","","","","","","","","","","","","","isampler2D","usampler2D","isamplerCube","usamplerCube","isampler3D","usampler3D","isampler2DArray","usampler2DArray"],$A=[["bool"],["i32"],["f32"],["vec2f","vec2<f32>"],["vec3f","vec3<f32>"],["vec4f","vec4<f32>"],["vec2i","vec2<i32>"],["vec3i","vec3<i32>"],["vec4i","vec4<i32>"],["vec2<bool>"],["vec3<bool>"],["vec4<bool>"],["mat2x2f","mat2x2<f32>"],["mat3x3f","mat3x3<f32>"],["mat4x4f","mat4x4<f32>"],["texture_2d<f32>"],["texture_cube<f32>"],["array<f32>"],["texture_depth_2d"],["texture_depth_cube"],["texture_3d<f32>"],["array<vec2<f32>>"],["array<vec3<f32>>"],["array<vec4<f32>>"],["array<mat4x4<f32>>"],["texture_2d_array<f32>"],["u32"],["vec2u","vec2<u32>"],["vec3u","vec3<u32>"],["vec4u","vec4<u32>"],["array<i32>"],["array<u32>"],["array<bool>"],["array<vec2i>","array<vec2<i32>>"],["array<vec2u>","array<vec2<u32>>"],["array<vec2b>","array<vec2<bool>>"],["array<vec3i>","array<vec3<i32>>"],["array<vec3u>","array<vec3<u32>>"],["array<vec3b>","array<vec3<bool>>"],["array<vec4i>","array<vec4<i32>>"],["array<vec4u>","array<vec4<u32>>"],["array<vec4b>","array<vec4<bool>>"],["texture_2d<i32>"],["texture_2d<u32>"],["texture_cube<i32>"],["texture_cube<u32>"],["texture_3d<i32>"],["texture_3d<u32>"],["texture_2d_array<i32>"],["texture_2d_array<u32>"]],KA=new Map;$A.forEach((l,e)=>{l.forEach(t=>KA.set(t,e))});var lw=new Uint8Array([pe,pe,_e,_e,_e,_e,pe,pe,pe,pe,pe,pe,_e,_e,_e,pe,pe,_e,pe,pe,pe,_e,_e,_e,_e,pe,Qe,Qe,Qe,Qe,pe,Qe,pe,pe,Qe,pe,pe,Qe,pe,pe,Qe,pe,pe,Qe,pe,Qe,pe,Qe,pe,Qe]),N_="webgl2",B_="webgl2:bare";var Qs=1,Js=2,B=4,U_="ldr";var Vo=1,Wl=2,Xl=4,Yl=8,jl=16,ql=32,$l=64,Kl=128,k_=255,jt=0,er=1,ui=2,mi=3,ca=["view","material","mesh","mesh_ub"],kr="default",G_="_unused_float_uniform",fu=[Int8Array,Uint8Array,Int16Array,Uint16Array,Int32Array,Uint32Array,Float32Array,Uint16Array],Zl=[1,1,2,2,4,4,4,2];var zo=[Uint8Array,Uint16Array,Uint32Array],V_=[1,2,4],Ql=new Map([["float","f32"],["vec2","vec2f"],["vec3","vec3f"],["vec4","vec4f"],["int","i32"],["ivec2","vec2i"],["ivec3","vec3i"],["ivec4","vec4i"],["uint","u32"],["uvec2","vec2u"],["uvec3","vec3u"],["uvec4","vec4u"]]),ue={};ue[le]=0;ue[ys]=1;ue[Xt]=2;ue[Yt]=3;ue[gt]=4;ue[$i]=5;ue[Ki]=6;ue[Zi]=7;ue[Qi]=8;ue[Ji]=9;ue[ea]=10;ue[ta]=11;ue[sa]=12;ue[ns]=13;ue[kA]=0;ue[GA]=1;ue[VA]=2;ue[zA]=3;ue[HA]=4;ue[WA]=5;ue[XA]=6;ue[YA]=7;ue[cu]=8;ue[hu]=9;ue[jA]=10;ue[Mo]=11;ue[Lo]=12;ue[qA]=13;ue[bo]=14;ue[Ar]=15;var ZA=0,ha=class{slot=-1;scopeId=null;constructor(e,t){this.name=e,this.visibility=t}get key(){return`${this.slot}:${this.name}:${this.visibility}`}},De=class extends ha{get key(){return`U${super.key}`}},V=class extends ha{format="";constructor(e,t,s=!1){super(e,t),this.readOnly=s}get key(){return`SB${super.key}:${this.readOnly?1:0}:${this.format}`}},Ds=class extends ha{samplerName=null;hasSampler;multisampled;substituteTexture;constructor(e,t,s=Ks,r=ni,i=!0,a=null,o=!1){super(e,t),this.textureDimension=s,this.multisampled=o,this.hasSampler=o?!1:i,this.samplerName=o?null:a??`${e}_sampler`,this.sampleType=o&&r===ni?zl:r,this.substituteTexture=e==="uSceneDepthMap"?"white":"pink"}get key(){let e=this.hasSampler?this.samplerName:"";return`T${super.key}:${this.textureDimension}:${this.sampleType}:${e}:${this.multisampled?1:0}`}},uu=class extends ha{constructor(e,t=Re,s=Ks,r=!0,i=!1){super(e,B),this.format=t,this.textureDimension=s,this.write=r,this.read=i}get key(){return`ST${super.key}:${this.format}:${this.textureDimension}:${this.write?1:0}:${this.read?1:0}`}},Ae=class{uniformBufferFormats=[];textureFormats=[];storageTextureFormats=[];storageBufferFormats=[];key;empty;constructor(e,t){this.id=ZA++;let s=0;t.forEach(i=>{i.slot=s++,i instanceof Ds&&i.hasSampler&&s++,i instanceof De?this.uniformBufferFormats.push(i):i instanceof Ds?this.textureFormats.push(i):i instanceof uu?this.storageTextureFormats.push(i):i instanceof V&&this.storageBufferFormats.push(i)}),this.key=t.map(i=>i.key).join(","),this.empty=t.length===0,this.device=e;let r=e.scope;this.bufferFormatsMap=new Map,this.uniformBufferFormats.forEach((i,a)=>this.bufferFormatsMap.set(i.name,a)),this.textureFormatsMap=new Map,this.textureFormats.forEach((i,a)=>{this.textureFormatsMap.set(i.name,a),i.scopeId=r.resolve(i.name)}),this.storageTextureFormatsMap=new Map,this.storageTextureFormats.forEach((i,a)=>{this.storageTextureFormatsMap.set(i.name,a),i.scopeId=r.resolve(i.name)}),this.storageBufferFormatsMap=new Map,this.storageBufferFormats.forEach((i,a)=>{this.storageBufferFormatsMap.set(i.name,a),i.scopeId=r.resolve(i.name)}),this.impl=e.createBindGroupFormatImpl(this)}destroy(){this.impl.destroy()}getTexture(e){let t=this.textureFormatsMap.get(e);return t!==void 0?this.textureFormats[t]:null}getStorageTexture(e){let t=this.storageTextureFormatsMap.get(e);return t!==void 0?this.storageTextureFormats[t]:null}loseContext(){}};var qt=class{map=new Map;id=0;get(e){let t=this.map.get(e);return t===void 0&&(t=this.id++,this.map.set(e,t)),t}};var QA=new qt,tr=class{texture;baseMipLevel;mipLevelCount;baseArrayLayer;arrayLayerCount;key;constructor(e,t=0,s=1,r=0,i=1){this.texture=e,this.baseMipLevel=t,this.mipLevelCount=s,this.baseArrayLayer=r,this.arrayLayerCount=i,this.key=QA.get(`${t}:${s}:${r}:${i}`)}};var JA=0,pi=class{bindGroup;offsets=new Uint32Array(1)},bt=class{renderVersionUpdated=-1;uniformBuffers;uniformBufferOffsets;_uniformBufferContainers=[];_textureImpls=[];_storageTextureImpls=[];constructor(e,t,s){this.id=JA++,this.device=e,this.format=t,this.dirty=!0,this.uniformBufferOffsets=new Uint32Array(t.uniformBufferFormats.length),this.impl=e.createBindGroupImpl(this),this.textures=[],this.storageTextures=[],this.storageBuffers=[],this.uniformBuffers=[],this.defaultUniformBuffer=s,s&&this.setUniformBuffer(kr,s)}destroy(){this.impl.destroy(),this.impl=null,this.format=null,this.defaultUniformBuffer=null}setUniformBuffer(e,t){let s=this.format.bufferFormatsMap.get(e);this.uniformBuffers[s]!==t&&(this.uniformBuffers[s]=t,this.dirty=!0)}setStorageBuffer(e,t){let s=this.format.storageBufferFormatsMap.get(e);this.setStorageBufferAt(s,t)}setStorageBufferAt(e,t){this.storageBuffers[e]!==t&&(this.storageBuffers[e]=t,this.dirty=!0)}setTexture(e,t){let s=this.format.textureFormatsMap.get(e);this.setTextureAt(s,t)}setTextureAt(e,t){let s=t instanceof tr?t.texture:t;this.textures[e]!==t?(this.textures[e]=t,this.dirty=!0):this.renderVersionUpdated<s.renderVersionDirty?this.dirty=!0:this._textureImpls[e]!==s.impl&&(this.dirty=!0),this._textureImpls[e]=s.impl}setStorageTexture(e,t){let s=this.format.storageTextureFormatsMap.get(e);this.setStorageTextureAt(s,t)}setStorageTextureAt(e,t){let s=t instanceof tr?t.texture:t;this.storageTextures[e]!==t?(this.storageTextures[e]=t,this.dirty=!0):this.renderVersionUpdated<s.renderVersionDirty?this.dirty=!0:this._storageTextureImpls[e]!==s.impl&&(this.dirty=!0),this._storageTextureImpls[e]=s.impl}updateUniformBuffers(){for(let e=0;e<this.uniformBuffers.length;e++)this.uniformBuffers[e].update()}update(){this._assignFromScope(),this._finalize()}commit(){this._revalidate(),this._finalize()}_assignFromScope(){let{textureFormats:e,storageTextureFormats:t,storageBufferFormats:s}=this.format;for(let r=0;r<e.length;r++){let i=e[r],a=i.scopeId.value;this.setTextureAt(r,a??this._substituteTexture(i))}for(let r=0;r<t.length;r++){let a=t[r].scopeId.value;this.setStorageTextureAt(r,a)}for(let r=0;r<s.length;r++){let a=s[r].scopeId.value;this.setStorageBufferAt(r,a)}}_substituteTexture(e){return this.device.builtInTextures[e.substituteTexture]}_revalidate(){let{textures:e,storageTextures:t}=this;for(let s=0;s<e.length;s++){let r=e[s];if(r){let i=r instanceof tr?r.texture:r;(this.renderVersionUpdated<i.renderVersionDirty||this._textureImpls[s]!==i.impl)&&(this._textureImpls[s]=i.impl,this.dirty=!0)}}for(let s=0;s<t.length;s++){let r=t[s];if(r){let i=r instanceof tr?r.texture:r;(this.renderVersionUpdated<i.renderVersionDirty||this._storageTextureImpls[s]!==i.impl)&&(this._storageTextureImpls[s]=i.impl,this.dirty=!0)}}}_finalize(){for(let e=0;e<this.uniformBuffers.length;e++){let t=this.uniformBuffers[e];if(this.uniformBufferOffsets[e]=t.offset,!t.persistent){let s=t.allocation.gpuBuffer;this._uniformBufferContainers[e]!==s&&(this._uniformBufferContainers[e]=s,this.dirty=!0)}}this.dirty&&(this.dirty=!1,this.renderVersionUpdated=this.device.renderVersion,this.impl.update(this))}};var me={set(l,e,t,s=1){return l&~(s<<t)|e<<t},get(l,e,t=1){return l>>e&t},all(l,e,t=1){let s=t<<e;return(l&s)===s},any(l,e,t=1){return(l&t<<e)!==0}};var eR=new qt,Jl=7,$t=31,z_=0,pu=3,_u=8,H_=13,gu=16,Su=21,Tu=26,W_=27,X_=28,Y_=29,j_=30,tR=15,sR=Tu,q_=1<<31,mu=2147483647,ec=8,tc=l=>l>=13&&l<=16,$_=l=>tc(me.get(l,pu,$t))||tc(me.get(l,_u,$t))||tc(me.get(l,gu,$t))||tc(me.get(l,Su,$t)),Ve=class l{attachment0=0;_attachments=null;_key=0;_keyDirty=!1;constructor(e=!1,t=0,s=1,r=0,i,a,o,n=!0,c=!0,h=!0,d=!0){this.setColorBlend(t,s,r),this.setAlphaBlend(i??t,a??s,o??r),this.setColorWrite(n,c,h,d),this.blend=e}set blend(e){this.attachment0=me.set(this.attachment0,e?1:0,j_),this._keyDirty=!0}get blend(){return me.all(this.attachment0,j_)}setColorBlend(e,t,s){this.attachment0=me.set(this.attachment0,e,z_,Jl),this.attachment0=me.set(this.attachment0,t,pu,$t),this.attachment0=me.set(this.attachment0,s,_u,$t),this._keyDirty=!0}setAlphaBlend(e,t,s){this.attachment0=me.set(this.attachment0,e,H_,Jl),this.attachment0=me.set(this.attachment0,t,gu,$t),this.attachment0=me.set(this.attachment0,s,Su,$t),this._keyDirty=!0}setColorWrite(e,t,s,r){this.redWrite=e,this.greenWrite=t,this.blueWrite=s,this.alphaWrite=r}get colorOp(){return me.get(this.attachment0,z_,Jl)}get colorSrcFactor(){return me.get(this.attachment0,pu,$t)}get colorDstFactor(){return me.get(this.attachment0,_u,$t)}get alphaOp(){return me.get(this.attachment0,H_,Jl)}get alphaSrcFactor(){return me.get(this.attachment0,gu,$t)}get alphaDstFactor(){return me.get(this.attachment0,Su,$t)}set redWrite(e){this.attachment0=me.set(this.attachment0,e?1:0,Tu),this._keyDirty=!0}get redWrite(){return me.all(this.attachment0,Tu)}set greenWrite(e){this.attachment0=me.set(this.attachment0,e?1:0,W_),this._keyDirty=!0}get greenWrite(){return me.all(this.attachment0,W_)}set blueWrite(e){this.attachment0=me.set(this.attachment0,e?1:0,X_),this._keyDirty=!0}get blueWrite(){return me.all(this.attachment0,X_)}set alphaWrite(e){this.attachment0=me.set(this.attachment0,e?1:0,Y_),this._keyDirty=!0}get alphaWrite(){return me.all(this.attachment0,Y_)}get allWrite(){return me.get(this.attachment0,sR,tR)}get hasAttachmentOverrides(){return this.attachment0<0}setAttachment(e,t){this._attachments?this.hasAttachmentOverrides||this._attachments.fill(0):this._attachments=new Int32Array(ec),this._attachments[e]=t?t.attachment0&mu:0,this._attachmentsUpdated()}clearAttachment(e){this.setAttachment(e,null)}getAttachment(e,t){let s=this.hasAttachmentOverrides?this._attachments[e]:0;return t.attachment0=s!==0?s:this.attachment0&mu,t}_attachmentsUpdated(){let e=this._attachments,t=!1;for(let s=1;s<ec;s++)if(e[s]!==0){t=!0;break}this.attachment0=t?this.attachment0|q_:this.attachment0&mu,t?this._evalKey():this._keyDirty=!1}_evalKey(){this._key=q_|eR.get(`${this.attachment0}-${this._attachments.join("-")}`),this._keyDirty=!1}get usesDualSourceBlending(){if($_(this.attachment0))return!0;if(this.hasAttachmentOverrides){let e=this._attachments;for(let t=1;t<ec;t++)if(e[t]!==0&&$_(e[t]))return!0}return!1}copy(e){return this.attachment0=e.attachment0,e.hasAttachmentOverrides&&(this._attachments??(this._attachments=new Int32Array(ec)),this._attachments.set(e._attachments)),this._key=e._key,this._keyDirty=e._keyDirty,this}clone(){return new this.constructor().copy(this)}get key(){return this.attachment0>=0?this.attachment0:(this._keyDirty&&this._evalKey(),this._key)}equals(e){return this.key===e.key}static NOBLEND=Object.freeze(new l);static get DEFAULT(){return l.NOBLEND}static NOWRITE=Object.freeze(new l(void 0,void 0,void 0,void 0,void 0,void 0,void 0,!1,!1,!1,!1));static ALPHABLEND=Object.freeze(new l(!0,0,6,8));static ADDBLEND=Object.freeze(new l(!0,0,1,1))};var et=class l{static calcLevelDimension(e,t){return Math.max(e>>t,1)}static calcMipLevelsCount(e,t,s=1){return 1+Math.floor(Math.log2(Math.max(e,t,s)))}static calcLevelGpuSize(e,t,s,r){let i=rt.get(r),a=rt.get(r)?.size??0;if(a>0)return e*t*s*a;let o=i.blockSize??0,n=Math.floor((e+3)/4),c=Math.floor((t+3)/4),h=Math.floor((s+3)/4);return(r===xo||r===Ao)&&(n=Math.max(Math.floor(n/2),1)),n*c*h*o}static calcGpuSize(e,t,s,r,i,a){let o=0;for(;o+=l.calcLevelGpuSize(e,t,s,r),!(!i||e===1&&t===1&&s===1);)e=Math.max(e>>1,1),t=Math.max(t>>1,1),s=Math.max(s>>1,1);return o*(a?6:1)}static calcTextureSize(e,t,s=1){let r=Math.ceil(Math.sqrt(e));return s>1&&(r=O.roundUp(r,s)),t.set(r,Math.ceil(e/r))}};var rR=0,se=class l{static createDataTexture2D(e,t,s,r,i,a){return new l(e,{name:t,width:s,height:r,format:i,mipmaps:!1,minFilter:0,magFilter:0,addressU:1,addressV:1,levels:a})}name;_gpuSize=0;releaseSourceAfterUpload=!1;id=rR++;_invalid=!1;_lockedLevel=-1;_lockedMode=kl;renderVersionDirty=0;uploadVersion=0;_storage=!1;_samples=1;_numLevels=0;_numLevelsRequested;constructor(e,t={}){this.device=e,this.name=t.name??"",this._width=Math.floor(t.width??4),this._height=Math.floor(t.height??4);let s=t.format??Re;this._format=t.srgb?nu(s):s,this._compressed=u_(this._format),this._integerFormat=qs(this._format),this._integerFormat&&(t.minFilter=0,t.magFilter=0),this._volume=t.volume??!1,this._depth=Math.floor(t.depth??1),this._arrayLength=Math.floor(t.arrayLength??0),this._storage=t.storage??!1,this._cubemap=t.cubemap??!1,this._flipY=t.flipY??!1,this._premultiplyAlpha=t.premultiplyAlpha??!1,(t.samples??1)>1&&e.isWebGPU&&(this._samples=e.maxSamples),this._mipmaps=(t.mipmaps??!0)&&this._samples===1,this._numLevelsRequested=t.numLevels,t.numLevels!==void 0&&(this._numLevels=t.numLevels),this._updateNumLevels(),this._minFilter=t.minFilter??5,this._magFilter=t.magFilter??1,this._anisotropy=t.anisotropy??1,this._addressU=t.addressU??0,this._addressV=t.addressV??0,this._addressW=t.addressW??0,this._compareOnRead=t.compareOnRead??!1,this._compareFunc=t.compareFunc??1,this._type=t.type??At,this.projection=T_,this._cubemap?this.projection=Uo:t.projection&&t.projection!==Uo&&(this.projection=t.projection),this._levels=t.levels;let i=!!t.levels;this._levels||this._clearLevels(),this.recreateImpl(i),this._samples>1&&(this._gpuSize=this.gpuSize,this.adjustVramSizeTracking(e._vram,this._gpuSize))}destroy(){let e=this.device;e&&(e.onTextureDestroyed(this),this.impl.destroy(e),this.adjustVramSizeTracking(e._vram,-this._gpuSize),this.releaseSourceAfterUpload&&this.releaseImageSources(),this._levels=null,this.device=null)}releaseImageSources(){if(this.releaseSourceAfterUpload=!1,!(typeof ImageBitmap>"u"||!this._levels))for(let e=0;e<this._levels.length;e++){let t=this._levels[e];if(t instanceof ImageBitmap)t.close(),this._levels[e]=null;else if(Array.isArray(t))for(let s=0;s<t.length;s++)t[s]instanceof ImageBitmap&&(t[s].close(),t[s]=null)}}setReleaseSourceAfterUpload(){this.releaseSourceAfterUpload=!0,!this._needsUpload&&!this._needsMipmapsUpload&&this.releaseImageSources()}recreateImpl(e=!0){let{device:t}=this;this.impl?.destroy(t),this.impl=null,this.impl=t.createTextureImpl(this),this.dirtyAll(),e&&this.upload()}_clearLevels(){this._levels=this._cubemap?[[null,null,null,null,null,null]]:[null]}resize(e,t,s=1){if(this.width!==e||this.height!==t||this.depth!==s){let r=this.device;this.adjustVramSizeTracking(r._vram,-this._gpuSize),this._gpuSize=0,this.impl.destroy(r),this._clearLevels(),this._width=Math.floor(e),this._height=Math.floor(t),this._depth=Math.floor(s),this._updateNumLevels(),this.impl=r.createTextureImpl(this),this.dirtyAll(),this._samples>1&&(this._gpuSize=this.gpuSize,this.adjustVramSizeTracking(r._vram,this._gpuSize))}}loseContext(){this.impl.loseContext(),this.dirtyAll()}adjustVramSizeTracking(e,t){e.tex+=t}propertyChanged(e){this.impl.propertyChanged(e),this.renderVersionDirty=this.device.renderVersion}_updateNumLevels(){let e=this.mipmaps?et.calcMipLevelsCount(this.width,this.height):1,t=this._numLevelsRequested;t!==void 0&&t>e,this._numLevels=Math.min(t??e,e),this._mipmaps=this._numLevels>1}get lockedMode(){return this._lockedMode}set minFilter(e){this._minFilter!==e&&(qs(this._format)||(this._minFilter=e,this.propertyChanged(Vo)))}get minFilter(){return this._minFilter}set magFilter(e){this._magFilter!==e&&(qs(this._format)||(this._magFilter=e,this.propertyChanged(Wl)))}get magFilter(){return this._magFilter}set addressU(e){this._addressU!==e&&(this._addressU=e,this.propertyChanged(Xl))}get addressU(){return this._addressU}set addressV(e){this._addressV!==e&&(this._addressV=e,this.propertyChanged(Yl))}get addressV(){return this._addressV}set addressW(e){this._volume&&e!==this._addressW&&(this._addressW=e,this.propertyChanged(jl))}get addressW(){return this._addressW}set compareOnRead(e){this._compareOnRead!==e&&(this._compareOnRead=e,this.propertyChanged(ql))}get compareOnRead(){return this._compareOnRead}set compareFunc(e){this._compareFunc!==e&&(this._compareFunc=e,this.propertyChanged($l))}get compareFunc(){return this._compareFunc}set anisotropy(e){this._anisotropy!==e&&(this._anisotropy=e,this.propertyChanged(Kl))}get anisotropy(){return this._anisotropy}set mipmaps(e){if(this._mipmaps!==e&&!qs(this._format)){let t=this._mipmaps,s=this._numLevels;this._mipmaps=e,this._updateNumLevels(),(this.array||this.device.isWebGPU)&&this._numLevels!==s?this.recreateImpl():this._mipmaps!==t&&(this.propertyChanged(Vo),this._mipmaps?(this._needsMipmapsUpload=!0,this.device?.texturesToUpload?.add(this)):this._needsMipmapsUpload=!1)}}get mipmaps(){return this._mipmaps}get numLevels(){return this._numLevels}get storage(){return this._storage}get samples(){return this._samples}get width(){return this._width}get height(){return this._height}get depth(){return this._depth}get format(){return this._format}get cubemap(){return this._cubemap}get gpuSize(){let e=this._mipmaps&&!(this._compressed&&this._levels.length===1);return et.calcGpuSize(this._width,this._height,this._depth,this._format,e,this._cubemap)*this._samples}get array(){return this._arrayLength>0}get arrayLength(){return this._arrayLength}get volume(){return this._volume}set type(e){this._type!==e&&(this._type=e,this.device._shadersDirty=!0)}get type(){return this._type}set rgbm(e){this.type=e?Vl:At}get rgbm(){return this.type===Vl}set swizzleGGGR(e){this.type=e?Fo:At}get swizzleGGGR(){return this.type===Fo}get _glTexture(){return this.impl._glTexture}set srgb(e){let t=Yi(this.format);if(e!==t)if(e){let s=nu(this.format);this._format!==s&&(this._format=s,this.recreateImpl(),this.device._shadersDirty=!0)}else{let s=m_(this.format);this._format!==s&&(this._format=s,this.recreateImpl(),this.device._shadersDirty=!0)}}get srgb(){return Yi(this.format)}set flipY(e){this._flipY!==e&&(this._flipY=e,this.markForUpload())}get flipY(){return this._flipY}set premultiplyAlpha(e){this._premultiplyAlpha!==e&&(this._premultiplyAlpha=e,this.markForUpload())}get premultiplyAlpha(){return this._premultiplyAlpha}get pot(){return O.powerOfTwo(this._width)&&O.powerOfTwo(this._height)}get encoding(){switch(this.type){case Vl:return"rgbm";case g_:return"rgbe";case ra:return"rgbp"}return p_(this.format)?"srgb":"linear"}dirtyAll(){this._levelsUpdated=this._cubemap?[[!0,!0,!0,!0,!0,!0]]:[!0],this.markForUpload(),this._needsMipmapsUpload=this._mipmaps,this._mipmapsUploaded=!1,this.propertyChanged(k_)}lock(e={}){var t,s;e.level??(e.level=0),e.face??(e.face=0),e.mode??(e.mode=Gl);let r=this._cubemap?(t=this._levels)[s=e.level]??(t[s]=[null,null,null,null,null,null]):this._levels,i=this._cubemap?e.face:e.level;if(!r[i]){let a=Math.max(1,this._width>>e.level),o=Math.max(1,this._height>>e.level),n=Math.max(1,this._depth>>e.level),c=new ArrayBuffer(et.calcLevelGpuSize(a,o,n,this._format));r[i]=new(Ul(this._format))(c)}return this._cubemap&&e.mode===Gl&&(this._levelsUpdated[0][e.face]=!0),this._lockedMode=e.mode,this._lockedLevel=e.level,r[i]}setSource(e,t=0){if(this.device._isHTMLElementInterface(e)&&(!this.device.supportsHtmlTextures||this._cubemap||this._volume))return;let s=!1,r,i;if(this._cubemap){if(e[0]){r=e[0].width||0,i=e[0].height||0;for(let a=0;a<6;a++){let o=e[a];if(!o||o.width!==r||o.height!==i||!this.device._isBrowserInterface(o)){s=!0;break}}}else s=!0;if(!s)for(let a=0;a<6;a++)this._levels[t][a]!==e[a]&&(this._levelsUpdated[t][a]=!0)}else if(this.device._isBrowserInterface(e)||(s=!0),!s)if(e!==this._levels[t]&&(this._levelsUpdated[t]=!0),typeof HTMLVideoElement<"u"&&e instanceof HTMLVideoElement)r=e.videoWidth,i=e.videoHeight;else if(this.device._isHTMLElementInterface(e)){let a=e.getBoundingClientRect();r=Math.floor(a.width)||1,i=Math.floor(a.height)||1}else r=e.width,i=e.height;if(s)if(this._width=4,this._height=4,this._cubemap)for(let a=0;a<6;a++)this._levels[t][a]=null,this._levelsUpdated[t][a]=!0;else this._levels[t]=null,this._levelsUpdated[t]=!0;else t===0&&(this._width=r,this._height=i),this._levels[t]=e;(this._invalid!==s||!s)&&(this._invalid=s,this.upload())}getSource(e=0){return this._levels[e]}unlock(){this._lockedMode,kl,this._lockedMode===Gl&&this.upload(),this._lockedLevel=-1,this._lockedMode=kl}markForUpload(){this._needsUpload=!0,this.device&&(this.uploadVersion=this.device.renderVersion),this.device?.texturesToUpload?.add(this)}upload(){this.markForUpload(),this._needsMipmapsUpload=this._mipmaps,this.impl.uploadImmediate?.(this.device,this)}read(e,t,s,r,i={}){return this.impl.read?.(e,t,s,r,i)}write(e,t,s,r,i){return this.impl.write?.(e,t,s,r,i)}_validateCopy(e,t){return!0}copy(e,t={}){return this._validateCopy(e,t)?this.impl.copy?.(e,t)??!0:!1}getView(e=0,t=1,s=0,r=1){return new tr(this,e,t,s,r)}};var ic=class{white;pink;constructor(e){let t=(s,r)=>se.createDataTexture2D(e,`built-in-texture-${s}`,1,1,Re,[new Uint8Array(r)]);this.white=t("white",[255,255,255,255]),this.pink=t("pink",[255,128,255,255])}destroy(){this.white.destroy(),this.pink.destroy()}};var aR=new qt,K_=7,Z_=0,Q_=3,Ot=class l{data=0;_depthBias=0;_depthBiasSlope=0;key=0;constructor(e=3,t=!0){this.func=e,this.write=t}set test(e){e!==this.test&&(this.func=e?3:7)}get test(){return this.func!==7}set write(e){this.data=me.set(this.data,e?1:0,Q_),this.updateKey()}get write(){return me.all(this.data,Q_)}set func(e){this.data=me.set(this.data,e,Z_,K_),this.updateKey()}get func(){return me.get(this.data,Z_,K_)}set depthBias(e){this._depthBias=e,this.updateKey()}get depthBias(){return this._depthBias}set depthBiasSlope(e){this._depthBiasSlope=e,this.updateKey()}get depthBiasSlope(){return this._depthBiasSlope}copy(e){return this.data=e.data,this._depthBias=e._depthBias,this._depthBiasSlope=e._depthBiasSlope,this.key=e.key,this}clone(){return new this.constructor().copy(this)}updateKey(){let{data:e,_depthBias:t,_depthBiasSlope:s}=this,r=`${e}-${t}-${s}`;this.key=aR.get(r)}equals(e){return this.key===e.key}static DEFAULT=Object.freeze(new l);static NODEPTH=Object.freeze(new l(7,!1));static WRITEDEPTH=Object.freeze(new l(7,!0))};var Ho=class{static createStorageView(e,t,s=0,r){let i=e.storage,a=ArrayBuffer.isView(i),o=a?i.buffer:i,n=(a?i.byteOffset:0)+s,c=t.BYTES_PER_ELEMENT;return new t(o,n,r??Math.floor((e.numBytes-s)/c))}};var oR=0,Vr=class{constructor(e,t,s,r=0,i,a){this.device=e,this.format=t,this.numIndices=s,this.usage=r,this.id=oR++,this.impl=e.createIndexBufferImpl(this,a);let o=V_[t];this.bytesPerIndex=o,this.numBytes=this.numIndices*o,i?this.setData(i):this.storage=new ArrayBuffer(this.numBytes),this.adjustVramSizeTracking(e._vram,this.numBytes),this.device.buffers.add(this)}destroy(){let e=this.device;e.buffers.delete(this),this.device.indexBuffer===this&&(this.device.indexBuffer=null),this.impl.initialized&&(this.impl.destroy(e),this.adjustVramSizeTracking(e._vram,-this.storage.byteLength))}adjustVramSizeTracking(e,t){e.ib+=t}loseContext(){this.impl.loseContext()}restoreContext(){this.unlock()}getFormat(){return this.format}getNumIndices(){return this.numIndices}lock(){return this.storage}unlock(e,t){if(e!==void 0||t!==void 0){e??(e=0),t??(t=this.numBytes-e);let s=e===0&&t===this.numBytes;if(!(Number.isInteger(e)&&e>=0&&e%4===0&&Number.isInteger(t)&&t>=0&&(s||t%4===0)&&e+t<=this.numBytes)||t===0)return}this.impl.unlock(this,e,t)}setData(e){return e.byteLength!==this.numBytes?!1:(this.storage=e,this.unlock(),!0)}writeData(e,t){let s=Ho.createStorageView(this,zo[this.format]);if(e.length>t)if(ArrayBuffer.isView(e))e=e.subarray(0,t),s.set(e);else for(let r=0;r<t;r++)s[r]=e[r];else s.set(e);this.unlock()}readData(e){let t=Ho.createStorageView(this,zo[this.format]),s=this.numIndices;if(ArrayBuffer.isView(e))e.set(e.length>=s?t:t.subarray(0,e.length));else{e.length=0;for(let r=0;r<s;r++)e[r]=t[r]}return s}};var fa=class{globalId=0;revision=0;equals(e){return this.globalId===e.globalId&&this.revision===e.revision}copy(e){this.globalId=e.globalId,this.revision=e.revision}reset(){this.globalId=0,this.revision=0}};var J_=0,ac=class{constructor(){J_++,this.version=new fa,this.version.globalId=J_}increment(){this.version.revision++}};var oc=class{constructor(e){this.name=e,this.value=null,this.versionObject=new ac}toJSON(e){}setValue(e){this.value=e,this.versionObject.increment()}getValue(){return this.value}};var nc=class{constructor(e){this.name=e,this.variables=new Map}resolve(e){return this.variables.has(e)||this.variables.set(e,new oc(e)),this.variables.get(e)}removeValue(e){for(let t of this.variables.values())t.value===e&&(t.value=null)}};var nR=0,sr=class{usage=0;_vaoKeyPart=null;constructor(e,t,s,r){this.usage=r?.usage??0,this.device=e,this.format=t,this.numVertices=s,this.id=nR++,this.impl=e.createVertexBufferImpl(this,t,r),this.numBytes=t.verticesByteSize?t.verticesByteSize:t.size*s,this.adjustVramSizeTracking(e._vram,this.numBytes);let i=r?.data;i?this.setData(i):this.storage=new ArrayBuffer(this.numBytes),this.device.buffers.add(this)}get vaoKeyPart(){return this._vaoKeyPart??(this._vaoKeyPart=`${this.id}_${this.format.renderingHash}_`),this._vaoKeyPart}destroy(){let e=this.device;e.buffers.delete(this),this.impl.initialized&&(this.impl.destroy(e),this.adjustVramSizeTracking(e._vram,-this.storage.byteLength))}adjustVramSizeTracking(e,t){e.vb+=t}loseContext(){this.impl.loseContext()}restoreContext(){this.unlock()}getFormat(){return this.format}getUsage(){return this.usage}getNumVertices(){return this.numVertices}lock(){return this.storage}unlock(e,t){if(e!==void 0||t!==void 0){e??(e=0),t??(t=this.numBytes-e);let s=e===0&&t===this.numBytes;if(!(Number.isInteger(e)&&e>=0&&e%4===0&&Number.isInteger(t)&&t>=0&&(s||t%4===0)&&e+t<=this.numBytes)||t===0)return}this.impl.unlock(this,e,t)}setData(e){return e.byteLength!==this.numBytes?!1:(this.storage=e,this.unlock(),!0)}};function $e(l){if(l==null)return 0;let e=0;for(let t=0,s=l.length;t<s;t++)e=(e<<5)-e+l.charCodeAt(t),e|=0;return e}function ua(l){let t=2166136261;for(let s=0;s<l.length;s++)t^=l[s],t=Math.imul(t,16777619);return t>>>0}var Se=class{_cache=new Map;get(e,t){return this._cache.has(e)||(this._cache.set(e,t()),e.on("destroy",()=>{this.remove(e)}),e.on("devicelost",()=>{this._cache.get(e)?.loseContext?.(e)})),this._cache.get(e)}remove(e){this._cache.get(e)?.destroy?.(e),this._cache.delete(e)}};var lR=new qt,cR=[2,4,8,12,16],hR=new Se,ma=class l{constructor(e,t,s){this.device=e,this._elements=[],this._uvMask=0,this.hasColor=!1,this.hasTangents=!1,this.verticesByteSize=0,this.vertexCount=s,this.interleaved=s===void 0,this.instancing=!1,this.size=t.reduce((a,o)=>a+Math.ceil(o.components*Zl[o.type]/4)*4,0);let r=0,i;for(let a=0,o=t.length;a<o;a++){let n=t[a];i=n.components*Zl[n.type],s&&(r=O.roundUp(r,i));let c=n.asInt??!1,h=c?!1:n.normalize??!1,d={name:n.semantic,offset:s?r:n.hasOwnProperty("offset")?n.offset:r,stride:s?i:n.hasOwnProperty("stride")?n.stride:this.size,dataType:n.type,numComponents:n.components,normalize:h,size:i,asInt:c};if(this._elements.push(d),s?r+=i*s:r+=Math.ceil(i/4)*4,n.semantic.startsWith(qi)){let f=parseInt(n.semantic.substring(qi.length),10);this._uvMask=me.set(this._uvMask,1,f)}else n.semantic===gt?this.hasColor=!0:n.semantic===ns&&(this.hasTangents=!0)}s&&(this.verticesByteSize=r),this._evaluateHash()}get elements(){return this._elements}get uvMask(){return this._uvMask}hasUv(e){return me.any(this._uvMask,e)}static getDefaultInstancingFormat(e){return hR.get(e,()=>new l(e,[{semantic:Mo,components:4,type:_e},{semantic:Lo,components:4,type:_e},{semantic:bo,components:4,type:_e},{semantic:Ar,components:4,type:_e}]))}static get defaultInstancingFormat(){return null}static isElementValid(e,t){let s=t.components*Zl[t.type];return!(e.isWebGPU&&!cR.includes(s))}update(){this._evaluateHash()}_evaluateHash(){let e=[],t=[],s=this._elements.length;for(let i=0;i<s;i++){let{name:a,dataType:o,numComponents:n,normalize:c,offset:h,stride:d,size:f,asInt:u}=this._elements[i],m=a+o+n+c+u;e.push(m);let _=m+h+d+f;t.push(_)}e.sort();let r=e.join();this.batchingHash=$e(r),this.shaderProcessingHashString=r,this.renderingHashString=t.join("_"),this.renderingHash=lR.get(this.renderingHashString)}};var dR=new qt,zr=class l{_func;_ref;_fail;_zfail;_zpass;_readMask;_writeMask;_dirty=!0;_key;set func(e){this._func=e,this._dirty=!0}get func(){return this._func}set ref(e){this._ref=e}get ref(){return this._ref}set fail(e){this._fail=e,this._dirty=!0}get fail(){return this._fail}set zfail(e){this._zfail=e,this._dirty=!0}get zfail(){return this._zfail}set zpass(e){this._zpass=e,this._dirty=!0}get zpass(){return this._zpass}set readMask(e){this._readMask=e,this._dirty=!0}get readMask(){return this._readMask}set writeMask(e){this._writeMask=e,this._dirty=!0}get writeMask(){return this._writeMask}constructor(e={}){this._func=e.func??7,this._ref=e.ref??0,this._readMask=e.readMask??255,this._writeMask=e.writeMask??255,this._fail=e.fail??Rr,this._zfail=e.zfail??Rr,this._zpass=e.zpass??Rr,this._evalKey()}_evalKey(){let{_func:e,_fail:t,_zfail:s,_zpass:r,_readMask:i,_writeMask:a}=this,o=`${e},${t},${s},${r},${i},${a}`;this._key=dR.get(o),this._dirty=!1}get key(){return this._dirty&&this._evalKey(),this._key}copy(e){return this._func=e._func,this._ref=e._ref,this._readMask=e._readMask,this._writeMask=e._writeMask,this._fail=e._fail,this._zfail=e._zfail,this._zpass=e._zpass,this._dirty=e._dirty,this._key=e._key,this}clone(){return new this.constructor().copy(this)}static DEFAULT=Object.freeze(new l)};var fR=0,re=class{id=fR++;constructor(e,t,s=0,r=!0){this.device=e,this.byteSize=t,this.bufferUsage=s;let i=r?128|s:s;this.impl=e.createBufferImpl(i),this.impl.allocate(e,t),e.buffers.add(this),this.adjustVramSizeTracking(e._vram,this.byteSize)}destroy(){let e=this.device;e.buffers.delete(this),this.impl.destroy(e),this.adjustVramSizeTracking(e._vram,-this.byteSize)}loseContext(){this.impl.loseContext()}restoreContext(){this.impl.allocate(this.device,this.byteSize)}adjustVramSizeTracking(e,t){e.sb+=t}read(e=0,t=this.byteSize,s=null,r=!1){return this.impl.read(this.device,e,t,s,r)}write(e=0,t,s=0,r){this.impl.write(this.device,e,t,s,r)}clear(e=0,t=this.byteSize){this.impl.clear(this.device,e,t)}copy(e,t=0,s=0,r=e.byteSize-t){this.device.getCommandEncoder().copyBufferToBuffer(e.impl.buffer,t,this.impl.buffer,s,r)}};var vu=class{gpuBuffer;stagingBuffer;offset;size},lc=class{storageBuffer;storageOffset;gpuBuffer;offset},cc=class{bufferSize;gpuBuffers=[];stagingBuffers=[];usedBuffers=[];activeBuffer=null;constructor(e,t,s){this.device=e,this.bufferSize=t,this.bufferAlignment=s}get bufferCount(){return(this.gpuBuffers?.length??0)+(this.usedBuffers?.length??0)+(this.activeBuffer?1:0)}destroy(){this.gpuBuffers.forEach(e=>{e.destroy(this.device)}),this.gpuBuffers=null,this.stagingBuffers.forEach(e=>{e.destroy(this.device)}),this.stagingBuffers=null,this.usedBuffers=null,this.activeBuffer=null}alloc(e,t){if(this.activeBuffer){let i=O.roundUp(this.activeBuffer.size,this.bufferAlignment);this.bufferSize-i<t&&this.scheduleSubmit()}if(!this.activeBuffer){let i=this.gpuBuffers.pop();i||(i=this.createBuffer(this.device,this.bufferSize,!1));let a=this.stagingBuffers.pop();a||(a=this.createBuffer(this.device,this.bufferSize,!0)),this.activeBuffer=new vu,this.activeBuffer.stagingBuffer=a,this.activeBuffer.gpuBuffer=i,this.activeBuffer.offset=0,this.activeBuffer.size=0}let s=this.activeBuffer,r=O.roundUp(s.size,this.bufferAlignment);e.gpuBuffer=s.gpuBuffer,e.offset=r,e.storageBuffer=s.stagingBuffer,e.storageOffset=r/4,s.size=r+t}scheduleSubmit(){this.activeBuffer&&(this.usedBuffers.push(this.activeBuffer),this.activeBuffer=null)}submit(){this.scheduleSubmit()}};var xe=[];xe[b]=function(l,e,t){let s=l.storageFloat32;s[t]=e};xe[ht]=(l,e,t)=>{let s=l.storageFloat32;s[t]=e[0],s[t+1]=e[1]};xe[Z]=(l,e,t)=>{let s=l.storageFloat32;s[t]=e[0],s[t+1]=e[1],s[t+2]=e[2]};xe[Pe]=(l,e,t)=>{let s=l.storageFloat32;s[t]=e[0],s[t+1]=e[1],s[t+2]=e[2],s[t+3]=e[3]};xe[ct]=function(l,e,t){let s=l.storageInt32;s[t]=e};xe[ls]=function(l,e,t){let s=l.storageInt32;s[t]=e[0],s[t+1]=e[1]};xe[Rt]=function(l,e,t){let s=l.storageInt32;s[t]=e[0],s[t+1]=e[1],s[t+2]=e[2]};xe[cs]=function(l,e,t){let s=l.storageInt32;s[t]=e[0],s[t+1]=e[1],s[t+2]=e[2],s[t+3]=e[3]};xe[di]=(l,e,t)=>{let s=l.storageFloat32;s[t]=e[0],s[t+1]=e[1],s[t+4]=e[2],s[t+5]=e[3],s[t+8]=e[4],s[t+9]=e[5]};xe[Cs]=(l,e,t)=>{let s=l.storageFloat32;s[t]=e[0],s[t+1]=e[1],s[t+2]=e[2],s[t+4]=e[3],s[t+5]=e[4],s[t+6]=e[5],s[t+8]=e[6],s[t+9]=e[7],s[t+10]=e[8]};xe[wr]=function(l,e,t,s){let r=l.storageFloat32;for(let i=0;i<s;i++)r[t+i*4]=e[i]};xe[Mr]=(l,e,t,s)=>{let r=l.storageFloat32;for(let i=0;i<s;i++)r[t+i*4]=e[i*2],r[t+i*4+1]=e[i*2+1]};xe[Lr]=(l,e,t,s)=>{let r=l.storageFloat32;for(let i=0;i<s;i++)r[t+i*4]=e[i*3],r[t+i*4+1]=e[i*3+1],r[t+i*4+2]=e[i*3+2]};xe[X]=(l,e,t,s)=>{let r=l.storageUint32;r[t]=e};xe[vs]=(l,e,t,s)=>{let r=l.storageUint32;r[t]=e[0],r[t+1]=e[1]};xe[xs]=(l,e,t,s)=>{let r=l.storageUint32;r[t]=e[0],r[t+1]=e[1],r[t+2]=e[2]};xe[Pt]=(l,e,t,s)=>{let r=l.storageUint32;r[t]=e[0],r[t+1]=e[1],r[t+2]=e[2],r[t+3]=e[3]};xe[As]=function(l,e,t,s){let r=l.storageInt32;for(let i=0;i<s;i++)r[t+i*4]=e[i]};xe[Fr]=xe[As];xe[br]=function(l,e,t,s){let r=l.storageUint32;for(let i=0;i<s;i++)r[t+i*4]=e[i]};xe[Rs]=(l,e,t,s)=>{let r=l.storageInt32;for(let i=0;i<s;i++)r[t+i*4]=e[i*2],r[t+i*4+1]=e[i*2+1]};xe[Nr]=xe[Rs];xe[Or]=(l,e,t,s)=>{let r=l.storageUint32;for(let i=0;i<s;i++)r[t+i*4]=e[i*2],r[t+i*4+1]=e[i*2+1]};xe[Ps]=(l,e,t,s)=>{let r=l.storageInt32;for(let i=0;i<s;i++)r[t+i*4]=e[i*3],r[t+i*4+1]=e[i*3+1],r[t+i*4+2]=e[i*3+2]};xe[Ur]=xe[Ps];xe[Br]=(l,e,t,s)=>{let r=l.storageUint32;for(let i=0;i<s;i++)r[t+i*4]=e[i*3],r[t+i*4+1]=e[i*3+1],r[t+i*4+2]=e[i*3+2]};var Nt=class{device;persistent;allocation;storageFloat32;storageInt32;storageUint32;storageOffset=0;constructor(e,t,s=!0){if(this.device=e,this.format=t,this.persistent=s,s){this.impl=e.createUniformBufferImpl(this);let r=new ArrayBuffer(t.byteSize);this.assignStorage(new Int32Array(r)),e._vram.ub+=this.format.byteSize,this.device.buffers.add(this)}else this.allocation=new lc}destroy(){if(this.persistent){let e=this.device;e.buffers.delete(this),this.impl.destroy(e),e._vram.ub-=this.format.byteSize}}get offset(){return this.persistent?0:this.allocation.offset}assignStorage(e){this.storageInt32=e,this.storageUint32=new Uint32Array(e.buffer,e.byteOffset,e.byteLength/4),this.storageFloat32=new Float32Array(e.buffer,e.byteOffset,e.byteLength/4),this.storageOffset=0}assignDynamicStorage(e,t){this.storageInt32=e.storageInt32,this.storageUint32=e.storageUint32,this.storageFloat32=e.storageFloat32,this.storageOffset=t}loseContext(){this.impl?.loseContext()}restoreContext(){this.impl?.unlock(this)}setUniform(e,t){let s=e.offset+this.storageOffset;if(t!=null){let r=xe[e.updateType];r?r(this,t,s,e.count):this.storageFloat32.set(t,s)}}set(e,t){let s=this.format.map.get(e);s&&this.setUniform(s,t)}startUpdate(e){if(!this.persistent){let t=this.allocation;this.device.dynamicBuffers.alloc(t,this.format.byteSize),this.assignDynamicStorage(t.storageBuffer,t.storageOffset),e&&(e.bindGroup=t.gpuBuffer.getBindGroup(this),e.offsets[0]=t.offset)}}endUpdate(){this.persistent?this.impl.unlock(this):(this.allocation.gpuBuffer.upload(),this.storageInt32=null,this.storageUint32=null,this.storageFloat32=null,this.storageOffset=0)}upload(){this.impl.unlock(this)}update(e){this.startUpdate(e);let t=this.format.uniforms;for(let s=0;s<t.length;s++){let r=t[s].scopeId.value;this.setUniform(t[s],r)}this.endUpdate()}};var Xe=new Ve,rr=new Ot,hc=class l extends de{canvas;backBuffer=null;backBufferSize=new k;backBufferFormat;backBufferAntialias=!1;isWebGPU=!1;isWebGL2=!1;isNull=!1;isHdr=!1;scope;maxIndirectDrawCount=1024;maxIndirectDispatchCount=256;maxAnisotropy;maxCubeMapSize;maxTextureSize;maxVolumeSize;maxColorAttachments=1;precision;samples;maxSamples=1;supportsStencil;supportsMultiDraw=!0;supportsIndirectDraw=!1;supportsMeshInstanceStorage=!1;meshInstanceStorage=null;supportsCompute=!1;supportsStorageTextureRead=!1;supportsSubgroups=!1;supportsSubgroupSizeControl=!1;supportsSubgroupUniformity=!1;supportsSubgroupId=!1;supportsLinearIndexing=!1;supportsPointerCompositeAccess=!1;supportsPacked4x8IntegerDotProduct=!1;supportsTextureAndSamplerLet=!1;supportsUnrestrictedPointerParameters=!1;maxSubgroupSize=0;minSubgroupSize=0;renderTarget=null;shaders=[];textures=new Set;texturesToUpload=new Set;targets=new Set;renderVersion=0;renderPassIndex=0;insideRenderPass=!1;usesMeshBindGroups=!1;supportsClipDistances=!1;supportsTransientAttachments=!1;supportsTextureFormatsTier1=!1;supportsTextureFormatsTier2=!1;supportsPrimitiveIndex=!1;supportsDualSourceBlending=!1;supportsIndependentBlending=!1;supportsShaderF16=!1;supportsHtmlTextures=!1;textureFloatRenderable;textureHalfFloatRenderable;textureRG11B10Renderable=!1;textureFloatFilterable=!1;textureFloatBlendable=!1;quadVertexBuffer;quadIndexBuffer;builtInTextures;blendState=new Ve;depthState=new Ot;stencilEnabled=!1;stencilFront=new zr;stencilBack=new zr;dynamicBuffers;gpuProfiler;_destroyed=!1;defaultClearOptions={color:[0,0,0,1],depth:1,stencil:0,flags:3};clientRect={width:0,height:0};_shadersDirty=!1;capsDefines=new Map;drawCommandsVersion=0;static EVENT_RESIZE="resizecanvas";constructor(e,t){var s,r,i,a,o,n,c,h,d;super(),this.canvas=e,"setAttribute"in e&&e.setAttribute("data-engine",`PlayCanvas ${tl}`),this.initOptions={...t},(s=this.initOptions).alpha??(s.alpha=!0),(r=this.initOptions).depth??(r.depth=!0),(i=this.initOptions).stencil??(i.stencil=!0),(a=this.initOptions).antialias??(a.antialias=!0),(o=this.initOptions).powerPreference??(o.powerPreference="high-performance"),(n=this.initOptions).displayFormat??(n.displayFormat=U_),(c=this.initOptions).transientColor??(c.transientColor=!1),(h=this.initOptions).transientDepth??(h.transientDepth=!1),(d=this.initOptions).xrCompatible??(d.xrCompatible=Oe.browser&&!!navigator.xr),this._maxPixelRatio=Oe.browser?Math.min(1,window.devicePixelRatio):1,this.buffers=new Set,this._vram={tex:0,vb:0,ib:0,ub:0,sb:0},this._shaderStats={vsCompiled:0,fsCompiled:0,linked:0,materialShaders:0,compileTime:0},this.initializeContextCaches(),this._drawCallsPerFrame=0,this._shaderSwitchesPerFrame=0,this._primitiveCount=0,this._renderTargetCreationTime=0,this.scope=new nc("Device"),this.textureBias=this.scope.resolve("textureBias"),this.textureBias.setValue(0),this.updateClientRect()}postInit(){let e=new ma(this,[{semantic:le,components:2,type:_e}]),t=new Float32Array([-1,-1,1,-1,-1,1,1,1]);this.quadVertexBuffer=new sr(this,e,4,{data:t});let s=new Uint16Array([0,1,2,2,1,3]);this.quadIndexBuffer=new Vr(this,1,6,0,s.buffer),this.builtInTextures=new ic(this)}initCapsDefines(){let{capsDefines:e}=this;e.clear(),this.textureFloatFilterable&&e.set("CAPS_TEXTURE_FLOAT_FILTERABLE",""),this.textureFloatRenderable&&e.set("CAPS_TEXTURE_FLOAT_RENDERABLE",""),this.supportsMultiDraw&&e.set("CAPS_MULTI_DRAW",""),this.supportsDualSourceBlending&&e.set("CAPS_DUAL_SOURCE_BLENDING",""),this.supportsPrimitiveIndex&&e.set("CAPS_PRIMITIVE_INDEX",""),this.supportsShaderF16&&e.set("CAPS_SHADER_F16",""),this.supportsSubgroups&&e.set("CAPS_SUBGROUPS",""),this.supportsSubgroupSizeControl&&e.set("CAPS_SUBGROUP_SIZE_CONTROL",""),this.supportsSubgroupId&&e.set("CAPS_SUBGROUP_ID",""),this.supportsLinearIndexing&&e.set("CAPS_LINEAR_INDEXING",""),this.supportsUnrestrictedPointerParameters&&e.set("CAPS_UNRESTRICTED_POINTER_PARAMETERS",""),this.supportsPointerCompositeAccess&&e.set("CAPS_POINTER_COMPOSITE_ACCESS",""),this.supportsPacked4x8IntegerDotProduct&&e.set("CAPS_PACKED_4X8_INTEGER_DOT_PRODUCT",""),this.supportsTextureAndSamplerLet&&e.set("CAPS_TEXTURE_AND_SAMPLER_LET",""),this.supportsStorageTextureRead&&e.set("CAPS_STORAGE_TEXTURE_READ",""),Oe.desktop&&e.set("PLATFORM_DESKTOP",""),Oe.mobile&&e.set("PLATFORM_MOBILE",""),Oe.android&&e.set("PLATFORM_ANDROID",""),Oe.ios&&e.set("PLATFORM_IOS","")}getResourceCounts(e){let t=0,s=0,r=this.dynamicBuffers?.bufferCount??0,i=0;for(let a of this.buffers)a instanceof sr?t++:a instanceof Vr?s++:a instanceof Nt?r++:a instanceof re&&i++;e.set("vertexBuffers",t),e.set("indexBuffers",s),e.set("uniformBuffers",r),e.set("storageBuffers",i),e.set("textures",this.textures.size),e.set("renderTargets",this.targets.size),e.set("shaders",this.shaders.length)}destroy(){this.fire("destroy"),this.quadVertexBuffer?.destroy(),this.quadVertexBuffer=null,this.quadIndexBuffer?.destroy(),this.quadIndexBuffer=null,this.builtInTextures?.destroy(),this.builtInTextures=null,this.dynamicBuffers?.destroy(),this.dynamicBuffers=null,this.gpuProfiler?.destroy(),this.gpuProfiler=null,this.meshInstanceStorage?.destroy(),this.meshInstanceStorage=null,this._destroyed=!0}onDestroyShader(e){this.fire("destroy:shader",e);let t=this.shaders.indexOf(e);t!==-1&&this.shaders.splice(t,1)}onTextureDestroyed(e){this.textures.delete(e),this.texturesToUpload.delete(e),this.scope.removeValue(e)}postDestroy(){this.scope=null,this.canvas=null}loseContext(){this.contextLost=!0,this.backBufferSize.set(-1,-1);for(let e of this.textures)e.loseContext();for(let e of this.buffers)e.loseContext();for(let e of this.targets)e.loseContext();this.gpuProfiler?.loseContext()}restoreContext(){this.contextLost=!1,this.initializeRenderState(),this.initializeContextCaches();for(let e of this.buffers)e.restoreContext();this.gpuProfiler?.restoreContext?.()}isContextLost(){return!!this.contextLost||this._destroyed}debugLoseContext(e=100){}toJSON(e){}initializeContextCaches(){this.vertexBuffers=[],this.shader=null,this.shaderValid=void 0,this.shaderAsyncCompile=!1,this.renderTarget=null}initializeRenderState(){this.blendState=new Ve,this.depthState=new Ot,this.cullMode=1,this.frontFace=0,this.alphaToCoverage=!1,this.vx=this.vy=this.vw=this.vh=0,this.sx=this.sy=this.sw=this.sh=0,this.blendColor=new z(0,0,0,0)}get boneLimit(){return 1024}get webgl2(){return this.isWebGL2}get textureFloatHighPrecision(){return!0}get extBlendMinmax(){return!0}get extTextureHalfFloat(){return!0}get extTextureLod(){return!0}get textureHalfFloatFilterable(){return!0}get supportsMrt(){return!0}get supportsVolumeTextures(){return!0}get supportsInstancing(){return!0}get textureHalfFloatUpdatable(){return!0}get extTextureFloat(){return!0}get extStandardDerivatives(){return!0}setBlendFunction(e,t){let s=this.blendState;Xe.copy(s),Xe.setColorBlend(s.colorOp,e,t),Xe.setAlphaBlend(s.alphaOp,e,t),this.setBlendState(Xe)}setBlendFunctionSeparate(e,t,s,r){let i=this.blendState;Xe.copy(i),Xe.setColorBlend(i.colorOp,e,t),Xe.setAlphaBlend(i.alphaOp,s,r),this.setBlendState(Xe)}setBlendEquation(e){let t=this.blendState;Xe.copy(t),Xe.setColorBlend(e,t.colorSrcFactor,t.colorDstFactor),Xe.setAlphaBlend(e,t.alphaSrcFactor,t.alphaDstFactor),this.setBlendState(Xe)}setBlendEquationSeparate(e,t){let s=this.blendState;Xe.copy(s),Xe.setColorBlend(e,s.colorSrcFactor,s.colorDstFactor),Xe.setAlphaBlend(t,s.alphaSrcFactor,s.alphaDstFactor),this.setBlendState(Xe)}setColorWrite(e,t,s,r){let i=this.blendState;Xe.copy(i),Xe.setColorWrite(e,t,s,r),this.setBlendState(Xe)}getBlending(){return this.blendState.blend}setBlending(e){Xe.copy(this.blendState),Xe.blend=e,this.setBlendState(Xe)}setDepthWrite(e){rr.copy(this.depthState),rr.write=e,this.setDepthState(rr)}setDepthFunc(e){rr.copy(this.depthState),rr.func=e,this.setDepthState(rr)}setDepthTest(e){rr.copy(this.depthState),rr.test=e,this.setDepthState(rr)}getCullMode(){return this.cullMode}setStencilState(e,t){}setBlendState(e){}setBlendColor(e,t,s,r){}setDepthState(e){}setCullMode(e){}setFrontFace(e){}setDrawStates(e=Ve.NOBLEND,t=Ot.NODEPTH,s=0,r=0,i,a){this.setBlendState(e),this.setDepthState(t),this.setCullMode(s),this.setFrontFace(r),this.setStencilState(i,a)}setRenderTarget(e){this.renderTarget=e}setVertexBuffer(e){e&&this.vertexBuffers.push(e)}clearVertexBuffer(){let e=this.vertexBuffers;for(;e.length>0;)e.pop()}getIndirectDrawSlot(e=1){return 0}get indirectDrawBuffer(){return null}getIndirectDispatchSlot(e=1){return 0}get indirectDispatchBuffer(){return null}getRenderTarget(){return this.renderTarget}initRenderTarget(e){e.initialized||(e.init(),this.targets.add(e))}draw(e,t,s,r,i=!0,a=!0,o=0){}_isBrowserInterface(e){return this._isImageBrowserInterface(e)||this._isImageCanvasInterface(e)||this._isImageVideoInterface(e)||this._isHTMLElementInterface(e)}_isImageBrowserInterface(e){return typeof ImageBitmap<"u"&&e instanceof ImageBitmap||typeof HTMLImageElement<"u"&&e instanceof HTMLImageElement}_isImageCanvasInterface(e){return typeof HTMLCanvasElement<"u"&&e instanceof HTMLCanvasElement}_isImageVideoInterface(e){return typeof HTMLVideoElement<"u"&&e instanceof HTMLVideoElement}_isHTMLElementInterface(e){return typeof HTMLElement<"u"&&e instanceof HTMLElement&&!(typeof HTMLImageElement<"u"&&e instanceof HTMLImageElement)&&!(typeof HTMLCanvasElement<"u"&&e instanceof HTMLCanvasElement)&&!(typeof HTMLVideoElement<"u"&&e instanceof HTMLVideoElement)}resizeCanvas(e,t){let s=Math.min(this._maxPixelRatio,Oe.browser?window.devicePixelRatio:1),r=Math.floor(e*s),i=Math.floor(t*s);r===0||i===0||(r!==this.canvas.width||i!==this.canvas.height)&&this.setResolution(r,i)}setResolution(e,t){this.canvas.width=e,this.canvas.height=t,this.fire(l.EVENT_RESIZE,e,t)}update(){this.updateClientRect()}updateClientRect(){if(typeof this.canvas.getBoundingClientRect=="function"){let e=this.canvas.getBoundingClientRect();this.clientRect.width=e.width,this.clientRect.height=e.height}else this.clientRect.width=this.canvas.width??0,this.clientRect.height=this.canvas.height??0}get width(){return this.canvas.width}get height(){return this.canvas.height}set fullscreen(e){}get fullscreen(){return!1}set maxPixelRatio(e){this._maxPixelRatio=e}get maxPixelRatio(){return this._maxPixelRatio}get deviceType(){return this._deviceType}startRenderPass(e){}endRenderPass(e){}startComputePass(e){}endComputePass(){}frameStart(){this.renderPassIndex=0,this.renderVersion++}frameEnd(){this.drawCommandsVersion++}computeDispatch(e,t="Unnamed"){}getRenderableHdrFormat(e=[Vi,ge,We],t=!0,s=1,r=!1){for(let i=0;i<e.length;i++){let a=e[i];switch(a){case Vi:{if(this.textureRG11B10Renderable)return a;break}case xr:case Wi:case ge:if(this.textureHalfFloatRenderable)return a;break;case lt:case Xi:case We:if(this.isWebGPU&&s>1)continue;if(this.textureFloatRenderable&&(!t||this.textureFloatFilterable)&&(!r||this.textureFloatBlendable))return a;break}}}validateAttributes(e,t){}};var uR=0,Le=class{name;_device;_colorBuffer;_colorBuffers;_depthBuffer;_resolveBuffers=null;_depthResolveBuffer=null;_depth;_stencil;_samples;_transientColor;_transientDepth;autoResolve;_depthResolveMode="min";_face;_mipLevel;_mipmaps;_width;_height;_flipY;_origin;constructor(e={}){this.id=uR++;let t=e.colorBuffer?.device??e.colorBuffers?.[0].device??e.depthBuffer?.device??e.graphicsDevice;this._device=t;let{maxSamples:s}=this._device,i=(e.colorBuffers??(e.colorBuffer?[e.colorBuffer]:void 0))?.find(d=>d?.samples>1),a=(e.depthBuffer?.samples??1)>1?e.depthBuffer:void 0,o=i??a,n=!!o;if(n?this._samples=o.samples:(this._samples=Math.min(e.samples??1,s),t.isWebGPU&&(this._samples=this._samples>1?s:1)),this._colorBuffer=e.colorBuffer,e.colorBuffer&&(this._colorBuffers=[e.colorBuffer]),this._depthBuffer=e.depthBuffer,this._face=e.face??0,this._depthBuffer){let d=this._depthBuffer._format;d===Lt||d===js?(this._depth=!0,this._stencil=!1):d===oi?(this._depth=!0,this._stencil=!0):d===lt&&this._depthBuffer.device.isWebGPU&&this._samples>1?(this._depth=!0,this._stencil=!1):(this._depth=!1,this._stencil=!1)}else this._depth=e.depth??!0,this._stencil=e.stencil??!1;e.colorBuffers&&(this._colorBuffers||(this._colorBuffers=[...e.colorBuffers],this._colorBuffer=e.colorBuffers[0]));let c=e.resolveBuffers??(e.resolveBuffer!==void 0?[e.resolveBuffer]:void 0);c&&n&&(this._resolveBuffers=[...c]),e.depthResolveBuffer&&a&&(this._depthResolveBuffer=e.depthResolveBuffer),this.autoResolve=e.autoResolve??!0,this.name=e.name,this.name||(this.name=this._colorBuffer?.name),this.name||(this.name=this._depthBuffer?.name),this.name||(this.name="Untitled"),this.depthResolveMode=e.depthResolveMode??"min";let h=!!this._device.supportsTransientAttachments;this._transientColor=(e.transientColor??!1)&&h&&this._samples>1&&!n,e.transientColor,this._transientDepth=(e.transientDepth??!1)&&h&&!this._depthBuffer,(e.transientDepth??!1)&&this._depthBuffer,e.origin==="top"?(this._flipY=!t.isWebGPU,this._origin="top"):e.origin===pt?(this._flipY=t.isWebGPU,this._origin=pt):e.origin===yo?(this._flipY=!1,this._origin=yo):(e.flipY,this._flipY=e.flipY??!1,this._origin=this._flipY?t.isWebGPU?pt:"top":yo),this._mipLevel=e.mipLevel??0,this._mipLevel>0&&n&&(this._mipLevel=0),this._mipLevel>0&&this._depth&&(this._mipLevel=0),this._mipmaps=e.mipLevel===void 0,this.evaluateDimensions(),this.validateMrt(),this.impl=t.createRenderTargetImpl(this)}destroy(){let e=this._device;e&&(e.targets.delete(this),e.renderTarget===this&&e.setRenderTarget(null),this.destroyFrameBuffers())}destroyFrameBuffers(){let e=this._device;e&&this.impl.destroy(e)}destroyTextureBuffers(){this._depthBuffer?.destroy(),this._depthBuffer=null,this._colorBuffers?.forEach(e=>{e.destroy()}),this._colorBuffers=null,this._colorBuffer=null,this._resolveBuffers?.forEach(e=>{e?.destroy()}),this._resolveBuffers=null,this._depthResolveBuffer?.destroy(),this._depthResolveBuffer=null}resize(e,t){if(!(this.mipLevel>0)&&(this._depthBuffer?.resize(e,t),this._colorBuffers?.forEach(s=>{s.resize(e,t)}),this._resolveBuffers?.forEach(s=>{s?.resize(e,t)}),this._depthResolveBuffer?.resize(e,t),this._width!==e||this._height!==t)){this.destroyFrameBuffers();let s=this._device;s.renderTarget===this&&s.setRenderTarget(null),this.evaluateDimensions(),this.validateMrt(),this.impl=s.createRenderTargetImpl(this)}}validateMrt(){}evaluateDimensions(){let e=this._colorBuffer??this._depthBuffer;e&&(this._width=e.width,this._height=e.height,this._mipLevel>0&&(this._width=et.calcLevelDimension(this._width,this._mipLevel),this._height=et.calcLevelDimension(this._height,this._mipLevel)))}init(){this.impl.init(this._device,this)}get initialized(){return this.impl.initialized}get device(){return this._device}loseContext(){this.impl.loseContext()}resolve(e=!0,t=!!this._depthBuffer){this._device&&this._samples>1&&this.impl.resolve(this._device,this,e,t)}copy(e,t,s){if(!this._device)if(e._device)this._device=e._device;else return!1;return this._device.copyRenderTarget(e,this,t,s)}set flipY(e){this._flipY=e,this._origin=e?this._device.isWebGPU?pt:"top":yo}get flipY(){return this._flipY}get origin(){return this._origin}get samples(){return this._samples}set depthResolveMode(e){this._depthResolveMode=e}get depthResolveMode(){return this._depthResolveMode}get transientColor(){return this._transientColor}get transientDepth(){return this._transientDepth}get depth(){return this._depth}get stencil(){return this._stencil}get colorBuffer(){return this._colorBuffer}get colorBufferCount(){return this._colorBuffers?.length??0}getColorBuffer(e){return this._colorBuffers?.[e]}get resolveBuffer(){return this._resolveBuffers?.[0]??null}getResolveBuffer(e=0){return this._resolveBuffers?.[e]??null}get depthBuffer(){return this._depthBuffer}get depthResolveBuffer(){return this._depthResolveBuffer}get face(){return this._face}get mipLevel(){return this._mipLevel}get mipmaps(){return this._mipmaps}get width(){return this._width??this._device.width}get height(){return this._height??this._device.height}set _glFrameBuffer(e){}get _glFrameBuffer(){return this.impl._glFrameBuffer}isColorBufferSrgb(e=0){if(this.device.backBuffer===this)return Yi(this.device.backBufferFormat);let t=this.getColorBuffer(e);return t?Yi(t.format):!1}};var ga=class{_refCount=0;incRefCount(){this._refCount++}decRefCount(){this._refCount--}get refCount(){return this._refCount}};var Au=class extends ga{object;constructor(e){super(),this.object=e,this.incRefCount()}},fc=class{cache=new Map;destroy(){this.cache.forEach(e=>{e.object?.destroy()}),this.cache.clear()}clear(){this.cache.clear()}get(e){let t=this.cache.get(e);return t?(t.incRefCount(),t.object):null}set(e,t){this.cache.set(e,new Au(t))}release(e){let t=this.cache.get(e);t&&(t.decRefCount(),t.refCount===0&&(this.cache.delete(e),t.object?.destroy()))}};var Ru=class extends fc{loseContext(e){this.clear()}},mR=new Se,uc=l=>mR.get(l,()=>new Ru);var Dt=class{_name;device;_enabled=!0;_skipStart=!1;_skipEnd=!1;executeEnabled=!0;requiresCubemaps=!1;beforePasses=[];afterPasses=[];constructor(e){this.device=e}set name(e){this._name=e}get name(){return this._name||(this._name=this.constructor.name),this._name}set enabled(e){this._enabled!==e&&(this._enabled=e,e?this.onEnable():this.onDisable())}get enabled(){return this._enabled}onEnable(){}onDisable(){}frameUpdate(){}before(){}execute(){}after(){}destroy(){}render(){this.enabled&&(this.before(),this.executeEnabled&&this.execute(),this.after(),this.device.renderPassIndex++)}};var Pu=class{clearValue=new z(0,0,0,1);clearValueLinear=new z(0,0,0,1);clear=!1;store=!1;resolve=!0;genMipmaps=!1},Du=class{clearDepthValue=1;clearStencilValue=0;clearDepth=!1;clearStencil=!1;storeDepth=!1;resolveDepth=!1;storeStencil=!1},ft=class extends Dt{renderTarget;_options;samples=0;colorArrayOps=[];get colorOps(){return this.colorArrayOps[0]}depthStencilOps;requiresCubemaps=!0;fullSizeClearRect=!0;set scaleX(e){this._options.scaleX=e}get scaleX(){return this._options.scaleX}set scaleY(e){this._options.scaleY=e}get scaleY(){return this._options.scaleY}set options(e){this._options=e,e&&(this.scaleX=this.scaleX??1,this.scaleY=this.scaleY??1)}get options(){return this._options}init(e=null,t){this.options=t,this.renderTarget=e,this.samples=Math.max(this.renderTarget?this.renderTarget.samples:this.device.samples,1),this.allocateAttachments(),this.postInit()}allocateAttachments(){let e=this.renderTarget;this.depthStencilOps=new Du,e?.depthBuffer&&(this.depthStencilOps.storeDepth=!0,e.depthResolveBuffer&&(this.depthStencilOps.resolveDepth=!0));let t=e?e._colorBuffers?.length??0:1;this.colorArrayOps.length=0;for(let s=0;s<t;s++){let r=new Pu;this.colorArrayOps[s]=r;let i=e?._colorBuffers?.[s];if(this.samples===1)r.store=!0,r.resolve=!1;else if(i?.samples>1){let a=!!e.getResolveBuffer(s);r.resolve=a,r.store=!a}if(e?.mipmaps&&i?.mipmaps){let a=qs(i._format);r.genMipmaps=!a}}}postInit(){}frameUpdate(){if(this._options&&this.renderTarget){let e=this._options.resizeSource??this.device.backBuffer,t=Math.floor(e.width*this.scaleX),s=Math.floor(e.height*this.scaleY);this.renderTarget.resize(t,s)}}setClearColor(e,t){let s=this.colorArrayOps.length,r=t??0,i=t===void 0?s:t+1;for(let a=r;a<i;a++){let o=this.colorArrayOps[a];o&&(e&&(o.clearValue.copy(e),o.clearValueLinear.linear(e)),o.clear=!!e)}}setClearDepth(e){e!==void 0&&(this.depthStencilOps.clearDepthValue=e),this.depthStencilOps.clearDepth=e!==void 0}setClearStencil(e){e!==void 0&&(this.depthStencilOps.clearStencilValue=e),this.depthStencilOps.clearStencil=e!==void 0}render(){if(this.enabled){let e=this.device,t=this.renderTarget!==void 0;this.before(),this.executeEnabled&&(t&&!this._skipStart&&e.startRenderPass(this),this.execute(),t&&!this._skipEnd&&e.endRenderPass(this)),this.after(),e.renderPassIndex++}}};var Ke=[];Ke[b]=1;Ke[ht]=2;Ke[Z]=3;Ke[Pe]=4;Ke[ct]=1;Ke[ls]=2;Ke[Rt]=3;Ke[cs]=4;Ke[Zs]=1;Ke[Pr]=2;Ke[Dr]=3;Ke[Ir]=4;Ke[di]=8;Ke[Cs]=12;Ke[Be]=16;Ke[X]=1;Ke[vs]=2;Ke[xs]=3;Ke[Pt]=4;var I=class{name;type;byteSize;offset;scopeId;count;numComponents;get isArrayType(){return this.count>0}constructor(e,t,s=0){if(this.shortName=e,this.name=s?`${e}[0]`:e,this.type=t,this.numComponents=Ke[t],this.updateType=t,s>0)switch(t){case b:this.updateType=wr;break;case ct:this.updateType=As;break;case X:this.updateType=br;break;case Zs:this.updateType=Fr;break;case ht:this.updateType=Mr;break;case ls:this.updateType=Rs;break;case vs:this.updateType=Or;break;case Pr:this.updateType=Nr;break;case Z:this.updateType=Lr;break;case Rt:this.updateType=Ps;break;case xs:this.updateType=Br;break;case Dr:this.updateType=Ur;break;case Pe:this.updateType=oa;break;case cs:this.updateType=fi;break;case Pt:this.updateType=na;break;case Ir:this.updateType=la;break;case Be:this.updateType=Hl;break;default:break}this.count=s;let r=this.numComponents;s&&(r=O.roundUp(r,4)),this.byteSize=r*4,s&&(this.byteSize*=s)}calculateOffset(e){let t=this.byteSize<=8?this.byteSize:16;this.count&&(t=16),e=O.roundUp(e,t),this.offset=e/4}},pR=l=>{let e=[],t=[],s=[],r=[];for(let a=0;a<l.length;a++){let o=l[a],n=o.byteSize;o.count||n>=16?e.push(o):n===12?t.push(o):n===8?s.push(o):r.push(o)}let i=0;for(let a=0;a<t.length;a++)e.push(t[a]),i<r.length&&e.push(r[i++]);for(let a=0;a<s.length;a++)e.push(s[a]);for(;i<r.length;i++)e.push(r[i]);return e},Te=class{byteSize=0;map=new Map;key;constructor(e,t,s={}){this.scope=e.scope,s.pack&&(t=pR(t)),this.uniforms=t;let r=0;for(let i=0;i<t.length;i++){let a=t[i];a.calculateOffset(r),r=a.offset*4+a.byteSize,a.scopeId=this.scope.resolve(a.name),this.map.set(a.name,a),a.count&&this.map.set(a.shortName,a)}this.byteSize=O.roundUp(r,16),this.key=t.map(i=>`${i.name}:${i.type}:${i.count}`).join(",")}get(e){return this.map.get(e)}};var Iu=class extends Map{destroy(){this.forEach(e=>e.destroy()),this.clear()}},_R=new Se,gR=(l,e)=>l.name<e.name?-1:l.name>e.name?1:0,tg=(l,e)=>{e.sort(gR);let t=[new De(kr,Qs|Js),...e],s=t.map(a=>a.key).join(","),r=_R.get(l,()=>new Iu),i=r.get(s);return i||(i=new Ae(l,t),r.set(s,i)),i};var sg=/[ \t]*(\battribute\b|\bvarying\b|\buniform\b)/g,wu=/(\battribute\b|\bvarying\b|\bout\b|\buniform\b)[ \t]*([^;]+)(;+)/g,SR=/([\w-]+)\[(.*?)\]/,TR=new Set(["highp","mediump","lowp"]),ER=new Set(["sampler2DShadow","samplerCubeShadow","sampler2DArrayShadow"]),yR={sampler2D:Ks,sampler3D:Oo,samplerCube:aa,samplerCubeShadow:aa,sampler2DShadow:Ks,sampler2DArray:ia,sampler2DArrayShadow:ia,isampler2D:Ks,usampler2D:Ks,isampler3D:Oo,usampler3D:Oo,isamplerCube:aa,usamplerCube:aa,isampler2DArray:ia,usampler2DArray:ia},CR={[Ks]:"texture2D",[aa]:"textureCube",[Oo]:"texture3D",[ia]:"texture2DArray"},mc=class{constructor(e,t){this.line=e;let s=e.trim().split(/\s+/);if(TR.has(s[0])&&(this.precision=s.shift()),this.type=s.shift(),e.includes(","),e.includes("[")){let r=s.join(" "),i=SR.exec(r);this.name=i[1],this.arraySize=Number(i[2]),isNaN(this.arraySize)&&(t.failed=!0)}else this.name=s.shift(),this.arraySize=0;this.isSampler=this.type.indexOf("sampler")!==-1,this.isSignedInt=this.type.indexOf("isampler")!==-1,this.isUnsignedInt=this.type.indexOf("usampler")!==-1}},Sa=class l{static MARKER="@@@";static run(e,t,s){let r=new Map,i=l.extract(t.vshader),a=l.extract(t.fshader),o=new Map,n=l.processAttributes(i.attributes,t.attributes,o,t.processingOptions),c=l.processVaryings(i.varyings,r,!0),h=l.processVaryings(a.varyings,r,!1),d=l.processOuts(a.outs),f=i.uniforms.concat(a.uniforms),m=Array.from(new Set(f)).map(x=>new mc(x,s)),_=l.processUniforms(e,m,t.processingOptions,s),p=`${n}
${c}
${_.code}`,g=i.src.replace(l.MARKER,p),T=`${h}
${d}
${_.code}`,S=a.src.replace(l.MARKER,T);return{vshader:g,fshader:S,attributes:o,meshUniformBufferFormat:_.meshUniformBufferFormat,meshBindGroupFormat:_.meshBindGroupFormat,viewBindGroupFormat:_.viewBindGroupFormat}}static extract(e,t=!1){let s=[],r=[],i=[],a=[],o=`${l.MARKER}
`,n;for(;(n=sg.exec(e))!==null;){let c=n[1];if(!(t&&c!=="uniform"))switch(c){case"attribute":case"varying":case"uniform":case"out":{wu.lastIndex=n.index;let h=wu.exec(e);c==="attribute"?s.push(h[2]):c==="varying"?r.push(h[2]):c==="out"?i.push(h[2]):c==="uniform"&&a.push(h[2]),e=l.cutOut(e,n.index,wu.lastIndex,o),sg.lastIndex=n.index+o.length,o="";break}}}return{src:e,attributes:s,varyings:r,outs:i,uniforms:a}}static parseUniformLines(e,t){return e.map(s=>new mc(s,t))}static processUniforms(e,t,s,r){let i=[],a=[];t.forEach(_=>{_.isSampler?i.push(_):a.push(_)});let o=[];a.forEach(_=>{if(!s.hasUniform(_.name)){s.debugCheckMeshUniform(_.name);let p=Go.indexOf(_.type),g=new I(_.name,p,_.arraySize);o.push(g)}}),o.length===0&&o.push(new I(G_,b));let n=o.length?new Te(e,o,{pack:!0}):null,c=[],h=[],d=s.viewTextures;i.forEach(_=>{if(!s.hasTexture(_.name)){let p=ni;_.isSignedInt?p=No:_.isUnsignedInt?p=Bo:(_.precision==="highp"&&(p=zl),ER.has(_.type)&&(p=S_));let g=yR[_.type],T=new Ds(_.name,Qs|Js,g,p);d?.has(_.name)?h.push(T):c.push(T)}});let f=new Ae(e,c),u=h.length?tg(e,h):null,m="";return s.uniformFormats.forEach((_,p)=>{_&&(m+=l.getUniformShaderDeclaration(_,p,0))}),u&&(m+=l.getTexturesShaderDeclaration(u,jt)),n&&(m+=l.getUniformShaderDeclaration(n,mi,0)),s.bindGroupFormats.forEach((_,p)=>{_&&(m+=l.getTexturesShaderDeclaration(_,p))}),m+=l.getTexturesShaderDeclaration(f,ui),{code:m,meshUniformBufferFormat:n,meshBindGroupFormat:f,viewBindGroupFormat:u}}static processVaryings(e,t,s){let r="",i=s?"out":"in";return e.forEach((a,o)=>{let n=l.splitToWords(a),c=n.slice(0,-1).join(" "),h=n[n.length-1];s?t.set(h,o):o=t.get(h),r+=`layout(location = ${o}) ${i} ${c} ${h};
`}),r}static processOuts(e){let t="";return e.forEach((s,r)=>{t+=`layout(location = ${r}) out ${s};
`}),t}static getTypeCount(e){let t=e.substring(e.length-1),s=parseInt(t,10);return isNaN(s)?1:s}static processAttributes(e,t,s,r){let i="",a={};return e.forEach(o=>{let n=l.splitToWords(o),c=n[0],h=n[1];if(t.hasOwnProperty(h)){let d=t[h],f=ue[d];a[f]=d,s.set(f,h);let u,m=r.getVertexElement(d);if(m){let _=m.dataType;if(_!==_e&&_!==y_&&!m.normalize&&!m.asInt){let p=l.getTypeCount(c),g=`_private_${h}`;u=`vec${p} ${h} = vec${p}(${g});
`,h=g;let T=_===li||_===hi||_===pe;p===1?c=T?"int":"uint":c=T?`ivec${p}`:`uvec${p}`}}i+=`layout(location = ${f}) in ${c} ${h};
`,u&&(i+=u)}}),i}static splitToWords(e){return e=e.replace(/\s+/g," ").trim(),e.split(" ")}static cutOut(e,t,s,r){return e.substring(0,t)+r+e.substring(s)}static getUniformShaderDeclaration(e,t,s){let r=ca[t],i=`layout(set = ${t}, binding = ${s}, std140) uniform ub_${r} {
`;return e.uniforms.forEach(a=>{let o=Go[a.type];i+=`    ${o} ${a.shortName}${a.count?`[${a.count}]`:""};
`}),`${i}};
`}static getTexturesShaderDeclaration(e,t){let s="";return e.textureFormats.forEach(r=>{let i=CR[r.textureDimension],a=i==="texture2DArray",o=r.sampleType===Bo?"u":r.sampleType===No?"i":"";i=`${o}${i}`;let n="",c="";a&&(n="_texture",c=`#define ${r.name} ${o}sampler2DArray(${r.name}${n}, ${r.name}_sampler)
`),s+=`layout(set = ${t}, binding = ${r.slot}) uniform ${i} ${r.name}${n};
`,r.hasSampler&&(s+=`layout(set = ${t}, binding = ${r.slot+1}) uniform sampler ${r.name}_sampler;
`),s+=c}),s}};var ds=/[ \t]*#(ifn?def|if|endif|else|elif|define|undef|extension|include)/g,Mu=/define[ \t]+([^\n]+)\r?(?:\n|$)/g,rg=/extension[ \t]+([\w-]+)[ \t]*:[ \t]*(enable|require)/g,Lu=/undef[ \t]+([^\n]+)\r?(?:\n|$)/g,bu=/(ifdef|ifndef|if)[ \t]*([^\r\n]+)\r?\n/g,Fu=/(endif|else|elif)(?:[ \t]+([^\r\n]*))?\r?\n?/g,ig=/\{?[\w-]+\}?/,vR=/(!|\s)?defined\(([\w-]+)\)/,xR=/!?defined\s*\([^)]*\)/g,AR=/!?defined\s*$/,RR=/([a-z_]\w*)\s*(==|!=|<|<=|>|>=)\s*([\w"']+)/i,PR=/[+\-]/g,Ou=/include[ \t]+"([\w-]+)(?:\s*,\s*([\w-]+))?"/g,DR=/\{i\}/g,ag=/(pcFragColor[1-8])\b/g,IR=/^\d+(?:\.\d+)?$/,Ta=class l{static sourceName;static run(e,t=new Map,s={}){l.sourceName=s.sourceName,e=this.stripComments(e),e=e.split(/\r?\n/).map(o=>o.trimEnd()).join(`
`);let r=new Map,i=new Map;if(e=this._preprocess(e,r,i,t,s.stripDefines),e===null)return null;let a=new Map;return r.forEach((o,n)=>{Number.isInteger(parseFloat(o))&&!o.includes(".")&&a.set(n,o)}),e=this.stripComments(e),e=this.injectDefines(e,i),e=this.stripUnusedColorAttachments(e,s),e=this.RemoveEmptyLines(e),e=this.processArraySize(e,a),e}static stripUnusedColorAttachments(e,t){if(t.stripUnusedColorAttachments){let s=new Map;if(e.match(ag)?.forEach(a=>{let o=parseInt(a.charAt(a.length-1),10);s.set(o,(s.get(o)??0)+1)}),Array.from(s.values()).some(a=>a===1)){let a=e.split(`
`),o=[];for(let n=0;n<a.length;n++){let c=a[n].match(ag);if(c){let h=parseInt(c[0].charAt(c[0].length-1),10);if(h>0&&s.get(h)===1)continue}o.push(a[n])}e=o.join(`
`)}}return e}static stripComments(e){return e.replace(/\/\*[\s\S]*?\*\/|([^\\:]|^)\/\/.*$/gm,"$1")}static processArraySize(e,t){return e!==null&&t.forEach((s,r)=>{e=e.replace(new RegExp(`\\[${r}\\]`,"g"),`[${s}]`)}),e}static injectDefines(e,t){if(e!==null&&t.size>0){let s=e.split(`
`);t.forEach((r,i)=>{let a=new RegExp(i,"g");for(let o=0;o<s.length;o++)s[o].includes("#")||(s[o]=s[o].replace(a,r))}),e=s.join(`
`)}return e}static RemoveEmptyLines(e){return e!==null&&(e=e.split(/\r?\n/).map(t=>t.trim()===""?"":t).join(`
`),e=e.replace(/(\n\n){3,}/g,`

`)),e}static _preprocess(e,t=new Map,s,r,i){let a=e,o=[],n=!1,c;for(;(c=ds.exec(e))!==null&&!n;){let h=c[1];switch(h){case"define":{Mu.lastIndex=c.index;let d=Mu.exec(e);n||(n=d===null);let f=d[1];ig.lastIndex=d.index;let m=ig.exec(f)[0],_=f.substring(m.length).trim();_===""&&(_="true");let p=l._keep(o),g=i;if(p){let T=m.startsWith("{")&&m.endsWith("}");T&&(g=!0),T?s.set(m,_):t.set(m,_),g&&(e=e.substring(0,d.index-1)+e.substring(Mu.lastIndex),ds.lastIndex=d.index-1)}g||(ds.lastIndex=d.index+d[0].length);break}case"undef":{Lu.lastIndex=c.index;let d=Lu.exec(e),f=d[1].trim();l._keep(o)&&(t.delete(f),i&&(e=e.substring(0,d.index-1)+e.substring(Lu.lastIndex),ds.lastIndex=d.index-1)),i||(ds.lastIndex=d.index+d[0].length);break}case"extension":{rg.lastIndex=c.index;let d=rg.exec(e);if(n||(n=d===null),d){let f=d[1];l._keep(o)&&t.set(f,"true")}ds.lastIndex=d.index+d[0].length;break}case"ifdef":case"ifndef":case"if":{bu.lastIndex=c.index;let d=bu.exec(e),f=d[2],u=l.evaluate(f,t);n||(n=u.error);let m=u.result;h==="ifndef"&&(m=!m),o.push({anyKeep:m,keep:m,start:c.index,end:bu.lastIndex}),ds.lastIndex=d.index+d[0].length;break}case"endif":case"else":case"elif":{Fu.lastIndex=c.index;let d=Fu.exec(e),f=o.pop();if(!f){console.error(`Shader preprocessing encountered "#${d[1]}" without a preceding #if #ifdef #ifndef while preprocessing ${l.sourceName} on line:
 ${e.substring(c.index,c.index+100)}...`,{source:a}),n=!0;continue}let u=f.keep?e.substring(f.end,c.index):"";e=e.substring(0,f.start)+u+e.substring(Fu.lastIndex),ds.lastIndex=f.start+u.length;let m=d[1];if(m==="else"||m==="elif"){let _=!1;if(!f.anyKeep)if(m==="else")_=!f.keep;else{let p=l.evaluate(d[2],t);_=p.result,n||(n=p.error)}o.push({anyKeep:f.anyKeep||_,keep:_,start:ds.lastIndex,end:ds.lastIndex})}break}case"include":{Ou.lastIndex=c.index;let d=Ou.exec(e);if(n||(n=d===null),!d){n=!0;continue}let f=d[1].trim(),u=d[2]?.trim();if(l._keep(o)){let _=r?.get(f);if(_!==void 0){if(_=this.stripComments(_),u){let p=t.get(u),g=parseFloat(p);if(Number.isInteger(g)){let T="";for(let S=0;S<g;S++)T+=_.replace(DR,String(S));_=T}else console.error(`Include Count identifier "${u}" not resolved while preprocessing ${l.sourceName} on line:
 ${e.substring(c.index,c.index+100)}...`,{originalSource:a,source:e}),n=!0}e=e.substring(0,d.index-1)+_+e.substring(Ou.lastIndex),ds.lastIndex=d.index-1}else{console.error(`Include "${f}" not resolved while preprocessing ${l.sourceName}`,{originalSource:a,source:e}),n=!0;continue}}break}}}return o.length>0&&(console.error(`Shader preprocessing reached the end of the file without encountering the necessary #endif to close a preceding #if, #ifdef, or #ifndef block. ${l.sourceName}`),n=!0),n?(console.error("Failed to preprocess shader: ",{source:a}),null):e}static _keep(e){for(let t=0;t<e.length;t++)if(!e[t].keep)return!1;return!0}static evaluateAtomicExpression(e,t){let s=!1;e=e.trim();let r=!1;if(e==="true")return{result:!0,error:s};if(e==="false")return{result:!1,error:s};if(IR.test(e))return{result:parseFloat(e)!==0,error:s};let i=vR.exec(e);if(i){r=i[1]==="!",e=i[2].trim();let n=t.has(e);return{result:r?!n:n,error:s}}let a=RR.exec(e);if(a){let n=t.get(a[1].trim())??a[1].trim(),c=t.get(a[3].trim())??a[3].trim(),h=a[2].trim(),d=!1;switch(h){case"==":d=n===c;break;case"!=":d=n!==c;break;case"<":d=n<c;break;case"<=":d=n<=c;break;case">":d=n>c;break;case">=":d=n>=c;break;default:s=!0}return{result:d,error:s}}return{result:t.has(e),error:s}}static processParentheses(e,t){let s=!1,r=e.trim();for(;r.startsWith("(")&&r.endsWith(")");){let i=0,a=!0;for(let o=0;o<r.length-1;o++)if(r[o]==="(")i++;else if(r[o]===")"&&(i--,i===0)){a=!1;break}if(a)r=r.slice(1,-1).trim();else break}for(;;){let i=!1,a=0,o=0,n=-1,c=-1,h=0;for(let m=0;m<r.length;m++)if(r[m]==="("){let _=r.substring(0,m);AR.test(_)?h++:h===0&&(a++,a>o&&(o=a,n=m),i=!0)}else r[m]===")"&&(h>0?h--:a>0&&(a===o&&n!==-1&&(c=m),a--));if(!i||n===-1||c===-1)break;let d=r.substring(n+1,c),{result:f,error:u}=l.evaluate(d,t);s=s||u,r=r.substring(0,n)+(f?"true":"false")+r.substring(c+1)}return{expression:r,error:s}}static evaluate(e,t){let s=PR.exec(e)===null,r=e,i=!1;if(e.replace(xR,"").indexOf("(")!==-1){let n=l.processParentheses(e,t);r=n.expression,i=n.error}if(i)return{result:!1,error:!0};let o=r.split("||");for(let n of o){let c=n.split("&&"),h=!0;for(let d of c){let{result:f,error:u}=l.evaluateAtomicExpression(d.trim(),t);if(!f||u){h=!1;break}}if(h)return{result:!0,error:!s}}return{result:!1,error:!s}}};var pc=`
#ifdef DUAL_SOURCE_BLENDING
#extension GL_EXT_blend_func_extended : require
#endif
#ifndef outType_0
#define outType_0 vec4
#endif
#ifdef DUAL_SOURCE_BLENDING
layout(location = 0, index = 0) out highp outType_0 pcFragColor0;
layout(location = 0, index = 1) out highp outType_0 pcFragColorSecondary;
#else
layout(location = 0) out highp outType_0 pcFragColor0;
#if COLOR_ATTACHMENT_1
layout(location = 1) out highp outType_1 pcFragColor1;
#endif
#if COLOR_ATTACHMENT_2
layout(location = 2) out highp outType_2 pcFragColor2;
#endif
#if COLOR_ATTACHMENT_3
layout(location = 3) out highp outType_3 pcFragColor3;
#endif
#if COLOR_ATTACHMENT_4
layout(location = 4) out highp outType_4 pcFragColor4;
#endif
#if COLOR_ATTACHMENT_5
layout(location = 5) out highp outType_5 pcFragColor5;
#endif
#if COLOR_ATTACHMENT_6
layout(location = 6) out highp outType_6 pcFragColor6;
#endif
#if COLOR_ATTACHMENT_7
layout(location = 7) out highp outType_7 pcFragColor7;
#endif
#endif
#define gl_FragColor pcFragColor0
#define varying in
#define texture2D texture
#define texture2DBias texture
#define textureCube texture
#define texture2DProj textureProj
#define texture2DLod textureLod
#define texture2DProjLod textureProjLod
#define textureCubeLod textureLod
#define texture2DGrad textureGrad
#define texture2DProjGrad textureProjGrad
#define textureCubeGrad textureGrad
#define utexture2D texture
#define itexture2D texture
#define texture2DLodEXT texture2DLodEXT_is_no_longer_supported_use_texture2DLod_instead
#define texture2DProjLodEXT texture2DProjLodEXT_is_no_longer_supported_use_texture2DProjLod
#define textureCubeLodEXT textureCubeLodEXT_is_no_longer_supported_use_textureCubeLod_instead
#define texture2DGradEXT texture2DGradEXT_is_no_longer_supported_use_texture2DGrad_instead
#define texture2DProjGradEXT texture2DProjGradEXT_is_no_longer_supported_use_texture2DProjGrad_instead
#define textureCubeGradEXT textureCubeGradEXT_is_no_longer_supported_use_textureCubeGrad_instead
#define textureShadow(res, uv) textureGrad(res, uv, vec2(1, 1), vec2(1, 1))
#define SHADOWMAP_PASS(name) name
#define SHADOWMAP_ACCEPT(name) sampler2DShadow name
#define TEXTURE_PASS(name) name
#define TEXTURE_ACCEPT(name) sampler2D name
#define TEXTURE_ACCEPT_HIGHP(name) highp sampler2D name
#define GL2
`;var _c=`
#extension GL_ANGLE_multi_draw : enable
#define attribute in
#define varying out
#define texture2D texture
#define utexture2D texture
#define itexture2D texture
#define GL2
#define VERTEXSHADER
#define TEXTURE_PASS(name) name
#define TEXTURE_ACCEPT(name) sampler2D name
#define TEXTURE_ACCEPT_HIGHP(name) highp sampler2D name
`;var gc=`
#extension GL_EXT_samplerless_texture_functions : require
#ifndef outType_0
#define outType_0 vec4
#endif
#ifndef outType_1
#define outType_1 vec4
#endif
#ifndef outType_2
#define outType_2 vec4
#endif
#ifndef outType_3
#define outType_3 vec4
#endif
#ifndef outType_4
#define outType_4 vec4
#endif
#ifndef outType_5
#define outType_5 vec4
#endif
#ifndef outType_6
#define outType_6 vec4
#endif
#ifndef outType_7
#define outType_7 vec4
#endif
#ifdef DUAL_SOURCE_BLENDING
layout(location = 0, index = 0) out highp outType_0 pcFragColor0;
layout(location = 0, index = 1) out highp outType_0 pcFragColorSecondary;
#else
layout(location = 0) out highp outType_0 pcFragColor0;
layout(location = 1) out highp outType_1 pcFragColor1;
layout(location = 2) out highp outType_2 pcFragColor2;
layout(location = 3) out highp outType_3 pcFragColor3;
layout(location = 4) out highp outType_4 pcFragColor4;
layout(location = 5) out highp outType_5 pcFragColor5;
layout(location = 6) out highp outType_6 pcFragColor6;
layout(location = 7) out highp outType_7 pcFragColor7;
#endif
#define gl_FragColor pcFragColor0
#define texture2D(res, uv) texture(sampler2D(res, res ## _sampler), uv)
#define texture2DBias(res, uv, bias) texture(sampler2D(res, res ## _sampler), uv, bias)
#define texture2DLod(res, uv, lod) textureLod(sampler2D(res, res ## _sampler), uv, lod)
#define textureCube(res, uv) texture(samplerCube(res, res ## _sampler), uv)
#define textureCubeLod(res, uv, lod) textureLod(samplerCube(res, res ## _sampler), uv, lod)
#define textureShadow(res, uv) textureLod(sampler2DShadow(res, res ## _sampler), uv, 0.0)
#define itexture2D(res, uv) texture(isampler2D(res, res ## _sampler), uv)
#define utexture2D(res, uv) texture(usampler2D(res, res ## _sampler), uv)
#define texture2DLodEXT texture2DLodEXT_is_no_longer_supported_use_texture2DLod_instead
#define texture2DProjLodEXT texture2DProjLodEXT_is_no_longer_supported_use_texture2DProjLod
#define textureCubeLodEXT textureCubeLodEXT_is_no_longer_supported_use_textureCubeLod_instead
#define texture2DGradEXT texture2DGradEXT_is_no_longer_supported_use_texture2DGrad_instead
#define texture2DProjGradEXT texture2DProjGradEXT_is_no_longer_supported_use_texture2DProjGrad_instead
#define textureCubeGradEXT textureCubeGradEXT_is_no_longer_supported_use_textureCubeGrad_instead
#define SHADOWMAP_PASS(name) name, name ## _sampler
#define SHADOWMAP_ACCEPT(name) texture2D name, sampler name ## _sampler
#define TEXTURE_PASS(name) name, name ## _sampler
#define TEXTURE_ACCEPT(name) texture2D name, sampler name ## _sampler
#define TEXTURE_ACCEPT_HIGHP TEXTURE_ACCEPT
#define GL2
#define WEBGPU
`;var Sc=`
#extension GL_EXT_samplerless_texture_functions : require
#define texture2D(res, uv) texture(sampler2D(res, res ## _sampler), uv)
#define itexture2D(res, uv) texture(isampler2D(res, res ## _sampler), uv)
#define utexture2D(res, uv) texture(usampler2D(res, res ## _sampler), uv)
#define TEXTURE_PASS(name) name, name ## _sampler
#define TEXTURE_ACCEPT(name) texture2D name, sampler name ## _sampler
#define TEXTURE_ACCEPT_HIGHP TEXTURE_ACCEPT
#define GL2
#define WEBGPU
#define VERTEXSHADER
#define gl_VertexID gl_VertexIndex
#define gl_InstanceID gl_InstanceIndex
`;var Tc=`
`;var Ec=`
#define VERTEXSHADER
`;var Nu=`
vec2 getGrabScreenPos(vec4 clipPos) {
	vec2 uv = (clipPos.xy / clipPos.w) * 0.5 + 0.5;
	#ifdef WEBGPU
		uv.y = 1.0 - uv.y;
	#endif
	return uv;
}
vec2 getImageEffectUV(vec2 uv) {
	#ifdef WEBGPU
		uv.y = 1.0 - uv.y;
	#endif
	return uv;
}
`;var Bu=`
#define WEBGPU
fn getGrabScreenPos(clipPos: vec4<f32>) -> vec2<f32> {
	var uv: vec2<f32> = (clipPos.xy / clipPos.w) * 0.5 + vec2<f32>(0.5);
	uv.y = 1.0 - uv.y;
	return uv;
}
fn getImageEffectUV(uv: vec2<f32>) -> vec2<f32> {
	var modifiedUV: vec2<f32> = uv;
	modifiedUV.y = 1.0 - modifiedUV.y;
	return modifiedUV;
}
struct WrappedF32 { @size(16) element: f32 }
struct WrappedI32 { @size(16) element: i32 }
struct WrappedU32 { @size(16) element: u32 }
struct WrappedVec2F { @size(16) element: vec2f }
struct WrappedVec2I { @size(16) element: vec2i }
struct WrappedVec2U { @size(16) element: vec2u }
`;var Xo=`
#ifdef CAPS_SHADER_F16
	alias half = f16;
	alias half2 = vec2<f16>;
	alias half3 = vec3<f16>;
	alias half4 = vec4<f16>;
	alias half2x2 = mat2x2<f16>;
	alias half3x3 = mat3x3<f16>;
	alias half4x4 = mat4x4<f16>;
#else
	alias half = f32;
	alias half2 = vec2f;
	alias half3 = vec3f;
	alias half4 = vec4f;
	alias half2x2 = mat2x2f;
	alias half3x3 = mat3x3f;
	alias half4x4 = mat4x4f;
#endif
`;var wR={vertex_position:le,vertex_normal:ys,vertex_tangent:ns,vertex_texCoord0:$i,vertex_texCoord1:Ki,vertex_texCoord2:Zi,vertex_texCoord3:Qi,vertex_texCoord4:Ji,vertex_texCoord5:ea,vertex_texCoord6:ta,vertex_texCoord7:sa,vertex_color:gt,vertex_boneIndices:Yt,vertex_boneWeights:Xt},It=class l{static createDefinition(e,t){let s=f=>{let u=f.fragmentOutputTypes??"vec4";return Array.isArray(u)||(u=[u]),u},r=(f,u,m,_)=>{let p=e.isWebGPU?f:u,g="";if(!m){_.useDualSourceBlending&&(g+=`#define DUAL_SOURCE_BLENDING
`);let T=s(_);for(let S=0;S<e.maxColorAttachments;S++){g+=`#define COLOR_ATTACHMENT_${S}
`;let x=T[S]??"vec4";g+=`#define outType_${S} ${x}
`}}return g+p},i=(f,u)=>{let m=l.getWGSLEnables(e,f?"vertex":"fragment",!f&&u.useDualSourceBlending);if(!f){let _=s(u);for(let p=0;p<e.maxColorAttachments;p++){let g=_[p]??"vec4",T=Ql.get(g);m+=`alias pcOutType${p} = ${T};
`}}return m},a=t.name??"Untitled",o,n,c=l.getDefinesCode(e,t.vertexDefines),h=l.getDefinesCode(e,t.fragmentDefines);return t.shaderLanguage===q?(o=`
								${i(!0,t)}
								${c}
								${Xo}
								${Ec}
								${Bu}
								${t.vertexCode}
						`,n=`
								${i(!1,t)}
								${h}
								${Xo}
								${Tc}
								${Bu}
								${t.fragmentCode}
						`):(o=`${l.versionCode(e)+r(Sc,_c,!0,t)+c+l.precisionCode(e)}
								${Nu}
								${l.getShaderNameCode(a)}
								${t.vertexCode}`,n=`${(t.fragmentPreamble||"")+l.versionCode(e)+r(gc,pc,!1,t)+h+l.precisionCode(e)}
								${Nu}
								${l.getShaderNameCode(a)}
								${t.fragmentCode}`),{name:a,shaderLanguage:t.shaderLanguage??ce,attributes:t.attributes,vshader:o,vincludes:t.vertexIncludes,fincludes:t.fragmentIncludes,fshader:n,feedbackVaryings:t.feedbackVaryings,feedbackVaryingsMode:t.feedbackVaryingsMode,useTransformFeedback:t.useTransformFeedback,meshUniformBufferFormat:t.meshUniformBufferFormat,meshBindGroupFormat:t.meshBindGroupFormat,useDualSourceBlending:!!t.useDualSourceBlending}}static getWGSLEnables(e,t,s=!1){let r="";return e.supportsShaderF16&&(r+=`enable f16;
`),t==="fragment"&&e.supportsPrimitiveIndex&&(r+=`enable primitive_index;
`),t==="fragment"&&s&&(r+=`enable dual_source_blending;
`),e.supportsSubgroups&&(r+=`enable subgroups;
`),e.supportsSubgroupId&&(r+=`requires subgroup_id;
`),t==="compute"&&e.supportsLinearIndexing&&(r+=`requires linear_indexing;
`),e.supportsUnrestrictedPointerParameters&&(r+=`requires unrestricted_pointer_parameters;
`),e.supportsPointerCompositeAccess&&(r+=`requires pointer_composite_access;
`),e.supportsPacked4x8IntegerDotProduct&&(r+=`requires packed_4x8_integer_dot_product;
`),e.supportsTextureAndSamplerLet&&(r+=`requires texture_and_sampler_let;
`),r}static getDefinesCode(e,t){let s="";return e.capsDefines.forEach((r,i)=>{s+=`#define ${i} ${r}
`}),s+=`
`,t?.forEach((r,i)=>{s+=`#define ${i} ${r}
`}),s+=`
`,s}static getShaderNameCode(e){return`#define SHADER_NAME ${e}
`}static versionCode(e){return e.isWebGPU?`#version 450
`:`#version 300 es
`}static precisionCode(e,t){t&&t!=="highp"&&t!=="mediump"&&t!=="lowp"&&(t=null),t&&(t==="highp"&&e.maxPrecision!=="highp"&&(t="mediump"),t==="mediump"&&e.maxPrecision==="lowp"&&(t="lowp"));let s=t||e.precision;return`
						precision ${s} float;
						precision ${s} int;
						precision ${s} usampler2D;
						precision ${s} isampler2D;
						precision ${s} sampler2DShadow;
						precision ${s} samplerCubeShadow;
						precision ${s} sampler2DArray;
				`}static collectAttributes(e){let t={},s=0,r=e.indexOf("attribute");for(;r>=0&&!(r>0&&e[r-1]==="/");){let i=!1;if(r>0){let a=e.lastIndexOf(`
`,r);a=a!==-1?a+1:0,e.substring(a,r).includes("#")&&(i=!0)}if(!i){let a=e.indexOf(";",r),o=e.lastIndexOf(" ",a),n=e.substring(o+1,a);if(!t[n]){let c=wR[n];c!==void 0?t[n]=c:(t[n]=`ATTR${s}`,s++)}}r=e.indexOf("attribute",r+1)}return t}};var MR=0,be=class{meshUniformBufferFormat;meshUniformBufferEmpty=!1;meshBindGroupFormat;viewBindGroupFormat=null;usesMeshInstanceStorage=!1;attributes=new Map;constructor(e,t){if(this.id=MR++,this.device=e,t={...t},this.definition=t,this.name=t.name||"Untitled",this.init(),t.cshader){let s=It.getWGSLEnables(e,"compute"),r=It.getDefinesCode(e,t.cdefines),i=s+r+t.cshader,a=new Map(t.cincludes);a.has("halfTypesCS")||a.set("halfTypesCS",Xo),t.cshader=Ta.run(i,a,{sourceName:`compute shader for ${this.label}`,stripDefines:!0})}else{let s=t.shaderLanguage===q;t.vshader=Ta.run(t.vshader,t.vincludes,{sourceName:`vertex shader for ${this.label}`,stripDefines:s}),t.shaderLanguage===ce&&(t.attributes??(t.attributes=It.collectAttributes(t.vshader)));let r=e.isWebGL2&&(Oe.name==="osx"||Oe.name==="ios");if(t.fshader=Ta.run(t.fshader,t.fincludes,{stripUnusedColorAttachments:r,stripDefines:s,sourceName:`fragment shader for ${this.label}`}),!t.vshader||!t.fshader){this.failed=!0;return}}this.impl=e.createShaderImpl(this),e.shaders.push(this)}init(){this.ready=!1,this.failed=!1}get label(){return`Shader Id ${this.id} (${this.definition.shaderLanguage===q?"WGSL":"GLSL"}) ${this.name}`}destroy(){this.device.onDestroyShader(this),this.impl?.destroy(this)}loseContext(){this.init(),this.impl.loseContext()}restoreContext(){this.impl.restoreContext(this.device,this)}};var yc=class{device;bindGroupCache=new Map;storageInt32=null;storageUint32=null;storageFloat32=null;constructor(e){this.device=e,this.bindGroupFormat=new Ae(this.device,[new De(kr,Qs|Js)])}setStorage(e){this.storageInt32=e?new Int32Array(e):null,this.storageUint32=e?new Uint32Array(e):null,this.storageFloat32=e?new Float32Array(e):null}upload(){}getBindGroup(e){let t=e.format.byteSize,s=this.bindGroupCache.get(t);return s||(s=new bt(this.device,this.bindGroupFormat,e),s.update(),this.bindGroupCache.set(t,s)),s}};var Cc=class{frameAllocations=[];pastFrameAllocations=new Map;_enabled=!1;_enableRequest=!1;_frameTime=0;_frameTimeValid=!1;_passTimings=new Map;_nameCache=new Map;maxCount=9999;loseContext(){this.invalidateTimings()}invalidateTimings(){this._frameTime=0,this._frameTimeValid=!1,this.pastFrameAllocations.clear(),this._passTimings.clear()}set enabled(e){this._enableRequest!==e&&(this._enableRequest=e,this.invalidateTimings())}get enabled(){return this._enableRequest}get frameTime(){return this._enableRequest&&this._enabled&&this._frameTimeValid?this._frameTime:void 0}get passTimings(){return this._passTimings}processEnableRequest(){this._enableRequest!==this._enabled&&(this._enabled=this._enableRequest,this._enabled||(this._frameTime=0))}request(e){this.pastFrameAllocations.set(e,this.frameAllocations),this.frameAllocations=[]}_parsePassName(e){let t=this._nameCache.get(e);return t===void 0&&(e.startsWith("RenderPass")?t=e.substring(10):t=e,this._nameCache.set(e,t)),t}report(e,t,s){if(t){let r=this.pastFrameAllocations.get(e);if(!r)return;t.length>0&&(this._frameTime=s??t.reduce((i,a)=>i+a,0),this._frameTimeValid=!0),this._passTimings.clear();for(let i=0;i<r.length;++i){let a=r[i],o=t[i],n=this._parsePassName(a);this._passTimings.set(n,(this._passTimings.get(n)||0)+o)}if(rl.get(o_)){let i=0;for(let a=0;a<r.length;++a){let o=r[a];i+=t[a]}}}this.pastFrameAllocations.delete(e)}getSlot(e){if(this.frameAllocations.length>=this.maxCount)return-1;let t=this.frameAllocations.length;return this.frameAllocations.push(e),t}get slotCount(){return this.frameAllocations.length}};var Hr=class{bufferId=null;uploadView=null;destroy(e){this.uploadView=null,this.bufferId&&(e.gl.deleteBuffer(this.bufferId),this.bufferId=null)}get initialized(){return!!this.bufferId}loseContext(){this.bufferId=null}unlock(e,t,s,r,i=0,a=r.byteLength-i){let o=e.gl;if(this.uploadView&&this.uploadView.buffer!==(r.buffer??r)&&(this.uploadView=null),this.bufferId)if(o.bindBuffer(s,this.bufferId),i===0&&a===r.byteLength)o.bufferSubData(s,0,r);else{let n=r.buffer??r,c=r.byteOffset??0,h=this.uploadView;(!h||h.buffer!==n||h.byteOffset!==c||h.byteLength!==r.byteLength)&&(h=this.uploadView=new Uint8Array(n,c,r.byteLength)),o.bufferSubData(s,i,h,i,a)}else{let n;switch(t){case 0:n=o.STATIC_DRAW;break;case 1:n=o.DYNAMIC_DRAW;break;case 2:n=o.STREAM_DRAW;break;case 3:n=o.DYNAMIC_COPY;break}this.bufferId=o.createBuffer(),o.bindBuffer(s,this.bufferId),o.bufferData(s,r,n)}}};var xc=class extends Hr{vao=null;destroy(e){super.destroy(e),e.unbindVertexArray()}loseContext(){super.loseContext(),this.vao=null}unlock(e,t,s){let r=e.device;super.unlock(r,e.usage,r.gl.ARRAY_BUFFER,e.storage,t,s)}};var Ac=class extends Hr{constructor(e){super();let t=e.device.gl,s=e.format;s===0?this.glFormat=t.UNSIGNED_BYTE:s===1?this.glFormat=t.UNSIGNED_SHORT:s===2&&(this.glFormat=t.UNSIGNED_INT)}unlock(e,t,s){let r=e.device;super.unlock(r,e.usage,r.gl.ELEMENT_ARRAY_BUFFER,e.storage,t,s)}};var Rc=class{constructor(e,t,s,r){if(this.locationId=r,this.scopeId=e.scope.resolve(t),this.version=new fa,t.substring(t.length-3)==="[0]")switch(s){case b:s=wr;break;case ct:s=As;break;case X:s=br;break;case Zs:s=Fr;break;case ht:s=Mr;break;case ls:s=Rs;break;case vs:s=Or;break;case Pr:s=Nr;break;case Z:s=Lr;break;case Rt:s=Ps;break;case xs:s=Br;break;case Dr:s=Ur;break;case Pe:s=oa;break;case cs:s=fi;break;case Pt:s=na;break;case Ir:s=la;break}this.dataType=s,this.value=[null,null,null,null],this.array=[]}};var Pc=class l extends Sa{static run(e,t,s){let r=l.extract(t.vshader,!0),i=l.extract(t.fshader,!0),a=r.uniforms.concat(i.uniforms),o=Array.from(new Set(a)),n=l.parseUniformLines(o,s),c=l.processUniformsGL2(n,t.processingOptions),h=r.src.replace(Sa.MARKER,c),d=i.src.replace(Sa.MARKER,c);return{vshader:h,fshader:d}}static processUniformsGL2(e,t){let s="";return t.uniformFormats.forEach((r,i)=>{r&&(s+=l.getUniformShaderDeclarationGL2(r,i))}),e.forEach(r=>{t.hasUniform(r.name)||(r.isSampler||t.debugCheckMeshUniform(r.name),s+=`uniform ${r.line};
`)}),s}static getUniformShaderDeclarationGL2(e,t){let r=`layout(std140) uniform ub_${ca[t]} {
`;return e.uniforms.forEach(i=>{let a=Go[i.type];r+=`    ${a} ${i.shortName}${i.count?`[${i.count}]`:""};
`}),`${r}};
`}};var og=new Set(["gl_VertexID","gl_InstanceID","gl_DrawID","gl_BaseVertex","gl_BaseInstance"]),ku=class{map=new Map;destroy(e){this.map.forEach(t=>{e.gl.deleteShader(t)})}loseContext(e){this.map.clear()}},bR=new Se,FR=new Se,Dc=class{compileDuration=0;constructor(e){this.init(),this.compile(e.device,e),this.link(e.device,e)}destroy(e){this.glProgram&&(e.device.gl.deleteProgram(this.glProgram),this.glProgram=null)}init(){this.uniforms=[],this.samplers=[],this.attributes=[],this.glProgram=null,this.glVertexShader=null,this.glFragmentShader=null,this._vsource=null,this._fsource=null}loseContext(){this.init()}restoreContext(e,t){this.compile(e,t),this.link(e,t)}compile(e,t){let s=t.definition,r=s.vshader,i=s.fshader;if(s.processingOptions){let a=Pc.run(e,s,t);r=a.vshader,i=a.fshader}this._vsource=r,this._fsource=i,this.glVertexShader=this._compileShaderSource(e,r,!0),this.glFragmentShader=this._compileShaderSource(e,i,!1)}link(e,t){if(this.glProgram)return;let s=e.gl;if(s.isContextLost())return;let r=0,i=s.createProgram();this.glProgram=i,s.attachShader(i,this.glVertexShader),s.attachShader(i,this.glFragmentShader);let a=t.definition,o=a.attributes;if(a.useTransformFeedback){let c=a.feedbackVaryings;if(!c){c=[];for(let d in o)o.hasOwnProperty(d)&&c.push(`out_${d}`)}let h=s.INTERLEAVED_ATTRIBS;a.feedbackVaryingsMode===1&&(h=s.SEPARATE_ATTRIBS),s.transformFeedbackVaryings(i,c,h)}let n={};for(let c in o)if(o.hasOwnProperty(c)){let h=o[c],d=ue[h];n[d]=c,s.bindAttribLocation(i,d,c)}s.linkProgram(i)}_compileShaderSource(e,t,s){let r=e.gl;if(r.isContextLost())return null;let a=(s?bR:FR).get(e,()=>new ku),o=a.map.get(t);return o||(o=r.createShader(s?r.VERTEX_SHADER:r.FRAGMENT_SHADER),r.shaderSource(o,t),r.compileShader(o),a.map.set(t,o)),o}finalize(e,t){let s=e.gl;if(s.isContextLost())return!0;let r=this.glProgram,i=t.definition,a=0;if(!s.getProgramParameter(r,s.LINK_STATUS)){if(!this._isCompiled(e,t,this.glVertexShader,this._vsource,"vertex")||!this._isCompiled(e,t,this.glFragmentShader,this._fsource,"fragment"))return!1;let f=`Failed to link shader program. Error: ${s.getProgramInfoLog(r)}`;return console.error(f),!1}let n=s.getProgramParameter(r,s.ACTIVE_ATTRIBUTES);t.attributes.clear();for(let f=0;f<n;f++){let u=s.getActiveAttrib(r,f),m=s.getAttribLocation(r,u.name);og.has(u.name)||(i.attributes[u.name]===void 0?(console.error(`Vertex shader attribute "${u.name}" is not mapped to a semantic in shader definition, shader [${t.label}]`,t),t.failed=!0):t.attributes.set(m,u.name))}let c=e._samplerTypes,h=s.getProgramParameter(r,s.ACTIVE_UNIFORMS);for(let f=0;f<h;f++){let u=s.getActiveUniform(r,f),m=s.getUniformLocation(r,u.name);if(og.has(u.name)||m===null)continue;let _=new Rc(e,u.name,e.pcUniformType[u.type],m);c.has(u.type)?this.samplers.push(_):this.uniforms.push(_)}let d=s.getProgramParameter(r,s.ACTIVE_UNIFORM_BLOCKS);for(let f=0;f<d;f++){let u=s.getActiveUniformBlockName(r,f),m=u.startsWith("ub_")?u.substring(3):u,_=ca.indexOf(m),p=_>=0?_:f;s.uniformBlockBinding(r,f,p)}return t.ready=!0,!0}_isCompiled(e,t,s,r,i){let a=e.gl;if(!a.getShaderParameter(s,a.COMPILE_STATUS)){let o=a.getShaderInfoLog(s),[n,c]=this._processError(r,o),h=`Failed to compile ${i} shader:

${o}
${n} while rendering undefined`;return console.error(h),!1}return!0}isLinked(e){let{extParallelShaderCompile:t}=e;return t?e.gl.getProgramParameter(this.glProgram,t.COMPLETION_STATUS_KHR):!0}_processError(e,t){let s={},r="";if(e){let i=e.split(`
`),a=0,o=i.length;if(t&&t.startsWith("ERROR:")){let n=t.match(/^ERROR:\s(\d+):(\d+):\s*(.+)/);n&&(s.message=n[3],s.line=parseInt(n[2],10),a=Math.max(0,s.line-6),o=Math.min(i.length,s.line+5))}for(let n=a;n<o;n++){let c=n+1===s.line?"> ":"  ";r+=`${c}${n+1}:	${i[n]}
`}s.source=e}return[r,s]}};var Ic=class extends Hr{unlock(e){let t=e.device,s=t.gl;super.unlock(t,1,s.UNIFORM_BUFFER,e.storageInt32)}};var wc=class{buffers=[];update(e){let t=e.uniformBuffers;this.buffers.length=t.length;for(let s=0;s<t.length;s++){let r=t[s];this.buffers[s]=r.persistent?r.impl:r.allocation.gpuBuffer}}destroy(){this.buffers.length=0}};var Mc=class{destroy(){}};var Lc=class extends yc{bufferId=null;size;constructor(e,t){super(e),this.size=t,this.setStorage(new ArrayBuffer(t)),e._vram.ub+=t}destroy(e){this.bufferId&&(e.gl.deleteBuffer(this.bufferId),this.bufferId=null),e._vram.ub-=this.size}loseContext(){this.bufferId=null}upload(){let e=this.device.gl;this.bufferId||(this.bufferId=e.createBuffer()),e.bindBuffer(e.UNIFORM_BUFFER,this.bufferId),e.bufferData(e.UNIFORM_BUFFER,this.storageInt32,e.STREAM_DRAW)}};var bc=class extends cc{free=new Map;used=[];constructor(e){super(e,0,0)}get bufferCount(){let e=this.used?.length??0;if(this.free)for(let t of this.free.values())e+=t.length;return e}destroy(){this.used.forEach(e=>e.destroy(this.device)),this.free.forEach(e=>e.forEach(t=>t.destroy(this.device))),this.used=null,this.free=null}alloc(e,t){let s=this.free.get(t)?.pop();s||(s=new Lc(this.device,t)),this.used.push(s),e.gpuBuffer=s,e.offset=0,e.storageBuffer=s,e.storageOffset=0}onFrameEnd(){let e=this.used;for(let t=0;t<e.length;t++){let s=e[t],r=this.free.get(s.size);r||(r=[],this.free.set(s.size,r)),r.push(s)}e.length=0}loseContext(){this.onFrameEnd(),this.free.forEach(e=>{e.forEach(t=>t.loseContext())})}};var Fc=class{indexSizeBytes;glCounts=null;glOffsetsBytes=null;glInstanceCounts=null;constructor(e){this.indexSizeBytes=e}allocate(e){this.glCounts&&this.glCounts.length===e||(this.glCounts=new Int32Array(e),this.glOffsetsBytes=new Int32Array(e),this.glInstanceCounts=new Int32Array(e))}add(e,t,s,r){this.glCounts[e]=t,this.glOffsetsBytes[e]=r*this.indexSizeBytes,this.glInstanceCounts[e]=s}};function ng(l,e){let t=l.width,s=l.height;if(t>e||s>e){let r=e/Math.max(t,s),i=Math.floor(t*r),a=Math.floor(s*r),o=document.createElement("canvas");return o.width=i,o.height=a,o.getContext("2d").drawImage(l,0,0,t,s,0,0,i,a),o}return l}var Oc=class{_glTexture=null;_glTarget;_glFormat;_glInternalFormat;_glPixelType;_glCreated;dirtyParameterFlags=0;constructor(e){this.texture=e}destroy(e){if(this._glTexture){for(let t=0;t<e.textureUnits.length;t++){let s=e.textureUnits[t];for(let r=0;r<s.length;r++)s[r]===this._glTexture&&(s[r]=null)}e.gl.deleteTexture(this._glTexture),this._glTexture=null}}loseContext(){this._glTexture=null}propertyChanged(e){this.dirtyParameterFlags|=e}initialize(e,t){let s=e.gl;switch(this._glTexture=s.createTexture(),this._glTarget=t._cubemap?s.TEXTURE_CUBE_MAP:t._volume?s.TEXTURE_3D:t.array?s.TEXTURE_2D_ARRAY:s.TEXTURE_2D,t._format){case Gf:this._glFormat=s.ALPHA,this._glInternalFormat=s.ALPHA,this._glPixelType=s.UNSIGNED_BYTE;break;case Vf:this._glFormat=s.LUMINANCE,this._glInternalFormat=s.LUMINANCE,this._glPixelType=s.UNSIGNED_BYTE;break;case zf:this._glFormat=s.LUMINANCE_ALPHA,this._glInternalFormat=s.LUMINANCE_ALPHA,this._glPixelType=s.UNSIGNED_BYTE;break;case Po:this._glFormat=s.RED,this._glInternalFormat=s.R8,this._glPixelType=s.UNSIGNED_BYTE;break;case Do:this._glFormat=s.RG,this._glInternalFormat=s.RG8,this._glPixelType=s.UNSIGNED_BYTE;break;case Sl:this._glFormat=s.RGB,this._glInternalFormat=s.RGB565,this._glPixelType=s.UNSIGNED_SHORT_5_6_5;break;case Tl:this._glFormat=s.RGBA,this._glInternalFormat=s.RGB5_A1,this._glPixelType=s.UNSIGNED_SHORT_5_5_5_1;break;case El:this._glFormat=s.RGBA,this._glInternalFormat=s.RGBA4,this._glPixelType=s.UNSIGNED_SHORT_4_4_4_4;break;case Co:this._glFormat=s.RGB,this._glInternalFormat=s.RGB8,this._glPixelType=s.UNSIGNED_BYTE;break;case Re:this._glFormat=s.RGBA,this._glInternalFormat=s.RGBA8,this._glPixelType=s.UNSIGNED_BYTE;break;case eu:case ru:break;case bl:this._glFormat=s.RGB,this._glInternalFormat=s.RGB9_E5,this._glPixelType=s.UNSIGNED_INT_5_9_9_9_REV;break;case Fl:this._glFormat=s.RG,this._glInternalFormat=s.RG8_SNORM,this._glPixelType=s.BYTE;break;case Ol:this._glFormat=s.RGBA,this._glInternalFormat=s.RGBA8_SNORM,this._glPixelType=s.BYTE;break;case Nl:this._glFormat=s.RGBA,this._glInternalFormat=s.RGB10_A2,this._glPixelType=s.UNSIGNED_INT_2_10_10_10_REV;break;case Bl:this._glFormat=s.RGBA_INTEGER,this._glInternalFormat=s.RGB10_A2UI,this._glPixelType=s.UNSIGNED_INT_2_10_10_10_REV;break;case Hf:this._glFormat=s.RGB,this._glInternalFormat=e.extCompressedTextureS3TC.COMPRESSED_RGB_S3TC_DXT1_EXT;break;case Wf:this._glFormat=s.RGBA,this._glInternalFormat=e.extCompressedTextureS3TC.COMPRESSED_RGBA_S3TC_DXT3_EXT;break;case vo:this._glFormat=s.RGBA,this._glInternalFormat=e.extCompressedTextureS3TC.COMPRESSED_RGBA_S3TC_DXT5_EXT;break;case Yf:this._glFormat=s.RGB,this._glInternalFormat=e.extCompressedTextureETC1.COMPRESSED_RGB_ETC1_WEBGL;break;case xo:this._glFormat=s.RGB,this._glInternalFormat=e.extCompressedTexturePVRTC.COMPRESSED_RGB_PVRTC_2BPPV1_IMG;break;case Ao:this._glFormat=s.RGBA,this._glInternalFormat=e.extCompressedTexturePVRTC.COMPRESSED_RGBA_PVRTC_2BPPV1_IMG;break;case $f:this._glFormat=s.RGB,this._glInternalFormat=e.extCompressedTexturePVRTC.COMPRESSED_RGB_PVRTC_4BPPV1_IMG;break;case Kf:this._glFormat=s.RGBA,this._glInternalFormat=e.extCompressedTexturePVRTC.COMPRESSED_RGBA_PVRTC_4BPPV1_IMG;break;case jf:this._glFormat=s.RGB,this._glInternalFormat=e.extCompressedTextureETC.COMPRESSED_RGB8_ETC2;break;case qf:this._glFormat=s.RGBA,this._glInternalFormat=e.extCompressedTextureETC.COMPRESSED_RGBA8_ETC2_EAC;break;case Zf:this._glFormat=s.RGBA,this._glInternalFormat=e.extCompressedTextureASTC.COMPRESSED_RGBA_ASTC_4x4_KHR;break;case Qf:this._glFormat=s.RGB,this._glInternalFormat=e.extCompressedTextureATC.COMPRESSED_RGB_ATC_WEBGL;break;case Jf:this._glFormat=s.RGBA,this._glInternalFormat=e.extCompressedTextureATC.COMPRESSED_RGBA_ATC_INTERPOLATED_ALPHA_WEBGL;break;case iu:this._glFormat=s.RGB,this._glInternalFormat=e.extTextureCompressionBPTC.COMPRESSED_RGB_BPTC_SIGNED_FLOAT_EXT;break;case au:this._glFormat=s.RGB,this._glInternalFormat=e.extTextureCompressionBPTC.COMPRESSED_RGB_BPTC_UNSIGNED_FLOAT_EXT;break;case ou:this._glFormat=s.RGBA,this._glInternalFormat=e.extTextureCompressionBPTC.COMPRESSED_RGBA_BPTC_UNORM_EXT;break;case dl:this._glFormat=s.SRGB,this._glInternalFormat=e.extCompressedTextureS3TC_SRGB.COMPRESSED_SRGB_S3TC_DXT1_EXT;break;case fl:this._glFormat=s.SRGB_ALPHA,this._glInternalFormat=e.extCompressedTextureS3TC_SRGB.COMPRESSED_SRGB_ALPHA_S3TC_DXT3_EXT;break;case ul:this._glFormat=s.SRGB_ALPHA,this._glInternalFormat=e.extCompressedTextureS3TC_SRGB.COMPRESSED_SRGB_ALPHA_S3TC_DXT5_EXT;break;case ml:this._glFormat=s.SRGB,this._glInternalFormat=e.extCompressedTextureETC.COMPRESSED_SRGB8_ETC2;break;case pl:this._glFormat=s.SRGB_ALPHA,this._glInternalFormat=e.extCompressedTextureETC.COMPRESSED_SRGB8_ALPHA8_ETC2_EAC;break;case _l:this._glFormat=s.SRGB_ALPHA,this._glInternalFormat=e.extCompressedTextureASTC.COMPRESSED_SRGB8_ALPHA8_ASTC_4x4_KHR;break;case gl:this._glFormat=s.RGBA,this._glInternalFormat=e.extTextureCompressionBPTC.COMPRESSED_SRGB_ALPHA_BPTC_UNORM_EXT;break;case xr:this._glFormat=s.RED,this._glInternalFormat=s.R16F,this._glPixelType=s.HALF_FLOAT;break;case Wi:this._glFormat=s.RG,this._glInternalFormat=s.RG16F,this._glPixelType=s.HALF_FLOAT;break;case yl:this._glFormat=s.RGB,this._glInternalFormat=s.RGB16F,this._glPixelType=s.HALF_FLOAT;break;case ge:this._glFormat=s.RGBA,this._glInternalFormat=s.RGBA16F,this._glPixelType=s.HALF_FLOAT;break;case Cl:this._glFormat=s.RGB,this._glInternalFormat=s.RGB32F,this._glPixelType=s.FLOAT;break;case We:this._glFormat=s.RGBA,this._glInternalFormat=s.RGBA32F,this._glPixelType=s.FLOAT;break;case lt:this._glFormat=s.RED,this._glInternalFormat=s.R32F,this._glPixelType=s.FLOAT;break;case Xi:this._glFormat=s.RG,this._glInternalFormat=s.RG32F,this._glPixelType=s.FLOAT;break;case Lt:this._glFormat=s.DEPTH_COMPONENT,this._glInternalFormat=s.DEPTH_COMPONENT32F,this._glPixelType=s.FLOAT;break;case js:this._glFormat=s.DEPTH_COMPONENT,this._glInternalFormat=s.DEPTH_COMPONENT16,this._glPixelType=s.UNSIGNED_SHORT;break;case oi:this._glFormat=s.DEPTH_STENCIL,this._glInternalFormat=s.DEPTH24_STENCIL8,this._glPixelType=s.UNSIGNED_INT_24_8;break;case Vi:this._glFormat=s.RGB,this._glInternalFormat=s.R11F_G11F_B10F,this._glPixelType=s.UNSIGNED_INT_10F_11F_11F_REV;break;case Xf:this._glFormat=s.RGB,this._glInternalFormat=s.SRGB8,this._glPixelType=s.UNSIGNED_BYTE;break;case vr:this._glFormat=s.RGBA,this._glInternalFormat=s.SRGB8_ALPHA8,this._glPixelType=s.UNSIGNED_BYTE;break;case vl:this._glFormat=s.RED_INTEGER,this._glInternalFormat=s.R8I,this._glPixelType=s.BYTE;break;case Ro:this._glFormat=s.RED_INTEGER,this._glInternalFormat=s.R8UI,this._glPixelType=s.UNSIGNED_BYTE;break;case xl:this._glFormat=s.RED_INTEGER,this._glInternalFormat=s.R16I,this._glPixelType=s.SHORT;break;case zi:this._glFormat=s.RED_INTEGER,this._glInternalFormat=s.R16UI,this._glPixelType=s.UNSIGNED_SHORT;break;case Al:this._glFormat=s.RED_INTEGER,this._glInternalFormat=s.R32I,this._glPixelType=s.INT;break;case xt:this._glFormat=s.RED_INTEGER,this._glInternalFormat=s.R32UI,this._glPixelType=s.UNSIGNED_INT;break;case Rl:this._glFormat=s.RG_INTEGER,this._glInternalFormat=s.RG8I,this._glPixelType=s.BYTE;break;case tu:this._glFormat=s.RG_INTEGER,this._glInternalFormat=s.RG8UI,this._glPixelType=s.UNSIGNED_BYTE;break;case Pl:this._glFormat=s.RG_INTEGER,this._glInternalFormat=s.RG16I,this._glPixelType=s.SHORT;break;case Dl:this._glFormat=s.RG_INTEGER,this._glInternalFormat=s.RG16UI,this._glPixelType=s.UNSIGNED_SHORT;break;case Il:this._glFormat=s.RG_INTEGER,this._glInternalFormat=s.RG32I,this._glPixelType=s.INT;break;case Hi:this._glFormat=s.RG_INTEGER,this._glInternalFormat=s.RG32UI,this._glPixelType=s.UNSIGNED_INT;break;case wl:this._glFormat=s.RGBA_INTEGER,this._glInternalFormat=s.RGBA8I,this._glPixelType=s.BYTE;break;case su:this._glFormat=s.RGBA_INTEGER,this._glInternalFormat=s.RGBA8UI,this._glPixelType=s.UNSIGNED_BYTE;break;case Ml:this._glFormat=s.RGBA_INTEGER,this._glInternalFormat=s.RGBA16I,this._glPixelType=s.SHORT;break;case _t:this._glFormat=s.RGBA_INTEGER,this._glInternalFormat=s.RGBA16UI,this._glPixelType=s.UNSIGNED_SHORT;break;case Ll:this._glFormat=s.RGBA_INTEGER,this._glInternalFormat=s.RGBA32I,this._glPixelType=s.INT;break;case Je:this._glFormat=s.RGBA_INTEGER,this._glInternalFormat=s.RGBA32UI,this._glPixelType=s.UNSIGNED_INT;break}this._glCreated=!1}upload(e,t){let s=e.gl;if(!t._needsUpload&&t._needsMipmapsUpload&&t._mipmapsUploaded)return;let r=0,i,a,o=t.numLevels;for(t.array&&!this._glCreated&&s.texStorage3D(s.TEXTURE_2D_ARRAY,o,this._glInternalFormat,t._width,t._height,t._arrayLength);t._levels[r]||r===0;){if(!t._needsUpload&&r===0){r++;continue}else if(r&&(!t._needsMipmapsUpload||!t._mipmaps))break;if(i=t._levels[r],a=1/Math.pow(2,r),r===1&&!t._compressed&&!t._integerFormat&&t._levels.length<o&&(s.generateMipmap(this._glTarget),t._mipmapsUploaded=!0),t._cubemap){let n;if(e._isBrowserInterface(i[0]))for(n=0;n<6;n++){if(!t._levelsUpdated[0][n])continue;let c=i[n];e._isImageBrowserInterface(c)&&(c.width>e.maxCubeMapSize||c.height>e.maxCubeMapSize)&&(c=ng(c,e.maxCubeMapSize),r===0&&(t._width=c.width,t._height=c.height)),e.setUnpackFlipY(!1),e.setUnpackPremultiplyAlpha(t._premultiplyAlpha),this._glCreated?s.texSubImage2D(s.TEXTURE_CUBE_MAP_POSITIVE_X+n,r,0,0,this._glFormat,this._glPixelType,c):s.texImage2D(s.TEXTURE_CUBE_MAP_POSITIVE_X+n,r,this._glInternalFormat,this._glFormat,this._glPixelType,c)}else for(a=1/Math.pow(2,r),n=0;n<6;n++){if(!t._levelsUpdated[0][n])continue;let c=i[n];t._compressed?this._glCreated&&c?s.compressedTexSubImage2D(s.TEXTURE_CUBE_MAP_POSITIVE_X+n,r,0,0,Math.max(t._width*a,1),Math.max(t._height*a,1),this._glInternalFormat,c):s.compressedTexImage2D(s.TEXTURE_CUBE_MAP_POSITIVE_X+n,r,this._glInternalFormat,Math.max(t._width*a,1),Math.max(t._height*a,1),0,c):(e.setUnpackFlipY(!1),e.setUnpackPremultiplyAlpha(t._premultiplyAlpha),e.setUnpackAlignment(1),this._glCreated&&c?s.texSubImage2D(s.TEXTURE_CUBE_MAP_POSITIVE_X+n,r,0,0,Math.max(t._width*a,1),Math.max(t._height*a,1),this._glFormat,this._glPixelType,c):s.texImage2D(s.TEXTURE_CUBE_MAP_POSITIVE_X+n,r,this._glInternalFormat,Math.max(t._width*a,1),Math.max(t._height*a,1),0,this._glFormat,this._glPixelType,c))}}else if(t._volume)t._compressed?s.compressedTexImage3D(s.TEXTURE_3D,r,this._glInternalFormat,Math.max(t._width*a,1),Math.max(t._height*a,1),Math.max(t._depth*a,1),0,i):(e.setUnpackFlipY(!1),e.setUnpackPremultiplyAlpha(t._premultiplyAlpha),e.setUnpackAlignment(1),s.texImage3D(s.TEXTURE_3D,r,this._glInternalFormat,Math.max(t._width*a,1),Math.max(t._height*a,1),Math.max(t._depth*a,1),0,this._glFormat,this._glPixelType,i));else if(t.array){if(Array.isArray(i)&&t._arrayLength===i.length)if(t._compressed)for(let n=0;n<t._arrayLength;n++)s.compressedTexSubImage3D(s.TEXTURE_2D_ARRAY,r,0,0,n,Math.max(Math.floor(t._width*a),1),Math.max(Math.floor(t._height*a),1),1,this._glInternalFormat,i[n]);else{e.setUnpackAlignment(1);for(let n=0;n<t._arrayLength;n++)s.texSubImage3D(s.TEXTURE_2D_ARRAY,r,0,0,n,Math.max(Math.floor(t._width*a),1),Math.max(Math.floor(t._height*a),1),1,this._glFormat,this._glPixelType,i[n])}}else{if(e._isBrowserInterface(i))if(e._isHTMLElementInterface(i)&&e.supportsHtmlTextures){e.setUnpackFlipY(t._flipY),e.setUnpackPremultiplyAlpha(t._premultiplyAlpha);let n=i.getBoundingClientRect(),c=Math.floor(n.width)||t._width,h=Math.floor(n.height)||t._height;s.texElementImage2D(s.TEXTURE_2D,this._glInternalFormat,i),r===0&&(t._width=c,t._height=h)}else{e._isImageBrowserInterface(i)&&(i.width>e.maxTextureSize||i.height>e.maxTextureSize)&&(i=ng(i,e.maxTextureSize),r===0&&(t._width=i.width,t._height=i.height));let n=i.width||i.videoWidth,c=i.height||i.videoHeight;e.setUnpackFlipY(t._flipY),e.setUnpackPremultiplyAlpha(t._premultiplyAlpha),this._glCreated&&t._width===n&&t._height===c&&!e._isImageVideoInterface(i)?s.texSubImage2D(s.TEXTURE_2D,r,0,0,this._glFormat,this._glPixelType,i):(s.texImage2D(s.TEXTURE_2D,r,this._glInternalFormat,this._glFormat,this._glPixelType,i),r===0&&(t._width=n,t._height=c))}else a=1/Math.pow(2,r),t._compressed?this._glCreated&&i?s.compressedTexSubImage2D(s.TEXTURE_2D,r,0,0,Math.max(Math.floor(t._width*a),1),Math.max(Math.floor(t._height*a),1),this._glInternalFormat,i):s.compressedTexImage2D(s.TEXTURE_2D,r,this._glInternalFormat,Math.max(Math.floor(t._width*a),1),Math.max(Math.floor(t._height*a),1),0,i):(e.setUnpackFlipY(!1),e.setUnpackPremultiplyAlpha(t._premultiplyAlpha),e.setUnpackAlignment(1),this._glCreated&&i?s.texSubImage2D(s.TEXTURE_2D,r,0,0,Math.max(t._width*a,1),Math.max(t._height*a,1),this._glFormat,this._glPixelType,i):s.texImage2D(s.TEXTURE_2D,r,this._glInternalFormat,Math.max(t._width*a,1),Math.max(t._height*a,1),0,this._glFormat,this._glPixelType,i));r===0?t._mipmapsUploaded=!1:t._mipmapsUploaded=!0}r++}if(t._needsUpload)if(t._cubemap)for(let n=0;n<6;n++)t._levelsUpdated[0][n]=!1;else t._levelsUpdated[0]=!1;!t._compressed&&!t._integerFormat&&t._mipmaps&&t._needsMipmapsUpload&&t._levels.length===1&&(s.generateMipmap(this._glTarget),t._mipmapsUploaded=!0),t._gpuSize&&t.adjustVramSizeTracking(e._vram,-t._gpuSize),t._gpuSize=t.gpuSize,t.adjustVramSizeTracking(e._vram,t._gpuSize),t.releaseSourceAfterUpload&&t.releaseImageSources(),this._glCreated=!0}uploadImmediate(e,t){e.isContextLost()||(t._needsUpload||t._needsMipmapsUpload)&&(e.setTexture(t,0),t._needsUpload=!1,t._needsMipmapsUpload=!1)}read(e,t,s,r,i){let a=this.texture;return a.device.readTextureAsync(a,e,t,s,r,i)}write(e,t,s,r,i){let{texture:a}=this,{device:o}=a;return o.setTexture(a,0),o.writeTextureAsync(a,e,t,s,r,i)}copy(e,t){return this.texture.device.copyTextureToTexture(e,this.texture,t)}};var OR=new Se,Gu=class{msaaFB;resolveFB;constructor(e,t){this.msaaFB=e,this.resolveFB=t}destroy(e){this.msaaFB&&(e.deleteRenderbuffer(this.msaaFB),this.msaaFB=null),this.resolveFB&&(e.deleteRenderbuffer(this.resolveFB),this.resolveFB=null)}},Nc=class{_glFrameBuffer=null;_glDepthBuffer=null;_glResolveFrameBuffer=null;colorMrtFramebuffers=null;_glMsaaColorBuffers=[];_glMsaaDepthBuffer=null;msaaDepthBufferKey;suppliedColorFramebuffer;_isInitialized=!1;destroy(e){let t=e.gl;this._isInitialized=!1,this._glFrameBuffer&&(this._glFrameBuffer!==this.suppliedColorFramebuffer&&t.deleteFramebuffer(this._glFrameBuffer),this._glFrameBuffer=null),this._glDepthBuffer&&(t.deleteRenderbuffer(this._glDepthBuffer),this._glDepthBuffer=null),this._glResolveFrameBuffer&&(this._glResolveFrameBuffer!==this.suppliedColorFramebuffer&&t.deleteFramebuffer(this._glResolveFrameBuffer),this._glResolveFrameBuffer=null),this._glMsaaColorBuffers.forEach(s=>{t.deleteRenderbuffer(s)}),this._glMsaaColorBuffers.length=0,this.colorMrtFramebuffers?.forEach(s=>{s.destroy(t)}),this.colorMrtFramebuffers=null,this._glMsaaDepthBuffer&&(this._glMsaaDepthBuffer=null,this.msaaDepthBufferKey&&uc(e).release(this.msaaDepthBufferKey)),this.suppliedColorFramebuffer=void 0}get initialized(){return this._isInitialized}init(e,t){let s=e.gl;this._isInitialized=!0;let r=[];if(this.suppliedColorFramebuffer!==void 0)this._glFrameBuffer=this.suppliedColorFramebuffer;else{this._glFrameBuffer=s.createFramebuffer(),e.setFramebuffer(this._glFrameBuffer);let i=t._colorBuffers?.length??0,a=s.COLOR_ATTACHMENT0;for(let n=0;n<i;++n){let c=t.getColorBuffer(n);c&&(c.impl._glTexture||(c._width=Math.min(c.width,e.maxRenderBufferSize),c._height=Math.min(c.height,e.maxRenderBufferSize),e.setTexture(c,0)),s.framebufferTexture2D(s.FRAMEBUFFER,a+n,c._cubemap?s.TEXTURE_CUBE_MAP_POSITIVE_X+t._face:s.TEXTURE_2D,c.impl._glTexture,t.mipLevel),r.push(a+n))}s.drawBuffers(r);let o=t._depthBuffer;if(o||t._depth){let n=t._stencil?s.DEPTH_STENCIL_ATTACHMENT:s.DEPTH_ATTACHMENT;if(o)o.impl._glTexture||(o._width=Math.min(o.width,e.maxRenderBufferSize),o._height=Math.min(o.height,e.maxRenderBufferSize),e.setTexture(o,0)),s.framebufferTexture2D(s.FRAMEBUFFER,n,o._cubemap?s.TEXTURE_CUBE_MAP_POSITIVE_X+t._face:s.TEXTURE_2D,t._depthBuffer.impl._glTexture,t.mipLevel);else if(!(t._samples>1)){this._glDepthBuffer||(this._glDepthBuffer=s.createRenderbuffer());let h=t._stencil?s.DEPTH24_STENCIL8:s.DEPTH_COMPONENT32F;s.bindRenderbuffer(s.RENDERBUFFER,this._glDepthBuffer),s.renderbufferStorage(s.RENDERBUFFER,h,t.width,t.height),s.framebufferRenderbuffer(s.FRAMEBUFFER,n,s.RENDERBUFFER,this._glDepthBuffer),s.bindRenderbuffer(s.RENDERBUFFER,null)}}}if(t._samples>1){this._glResolveFrameBuffer=this._glFrameBuffer,this._glFrameBuffer=s.createFramebuffer(),e.setFramebuffer(this._glFrameBuffer);let i=t._colorBuffers?.length??0;if(this.suppliedColorFramebuffer!==void 0){let a=s.createRenderbuffer();this._glMsaaColorBuffers.push(a);let o=e.backBufferFormat===Re?s.RGBA8:s.RGB8;s.bindRenderbuffer(s.RENDERBUFFER,a),s.renderbufferStorageMultisample(s.RENDERBUFFER,t._samples,o,t.width,t.height),s.framebufferRenderbuffer(s.FRAMEBUFFER,s.COLOR_ATTACHMENT0,s.RENDERBUFFER,a)}else for(let a=0;a<i;++a){let o=t.getColorBuffer(a);if(o){let n=s.createRenderbuffer();this._glMsaaColorBuffers.push(n),s.bindRenderbuffer(s.RENDERBUFFER,n),s.renderbufferStorageMultisample(s.RENDERBUFFER,t._samples,o.impl._glInternalFormat,t.width,t.height),s.framebufferRenderbuffer(s.FRAMEBUFFER,s.COLOR_ATTACHMENT0+a,s.RENDERBUFFER,n)}}if(t._depth){let a=t._stencil?s.DEPTH24_STENCIL8:s.DEPTH_COMPONENT32F,o=t._stencil?s.DEPTH_STENCIL_ATTACHMENT:s.DEPTH_ATTACHMENT,n,c=t._depthBuffer;c&&(n=`${c.id}:${t.width}:${t.height}:${t._samples}:${a}:${o}`,this._glMsaaDepthBuffer=uc(e).get(n)),this._glMsaaDepthBuffer||(this._glMsaaDepthBuffer=s.createRenderbuffer(),s.bindRenderbuffer(s.RENDERBUFFER,this._glMsaaDepthBuffer),s.renderbufferStorageMultisample(s.RENDERBUFFER,t._samples,a,t.width,t.height),this._glMsaaDepthBuffer.destroy=function(){s.deleteRenderbuffer(this)},c&&uc(e).set(n,this._glMsaaDepthBuffer)),this.msaaDepthBufferKey=n,s.framebufferRenderbuffer(s.FRAMEBUFFER,o,s.RENDERBUFFER,this._glMsaaDepthBuffer)}i>1&&(this._createMsaaMrtFramebuffers(e,t,i),e.setFramebuffer(this._glFrameBuffer),s.drawBuffers(r))}}_createMsaaMrtFramebuffers(e,t,s){let r=e.gl;this.colorMrtFramebuffers=[];for(let i=0;i<s;++i){let a=t.getColorBuffer(i),o=r.createFramebuffer();e.setFramebuffer(o);let n=this._glMsaaColorBuffers[i];r.bindRenderbuffer(r.RENDERBUFFER,n),r.renderbufferStorageMultisample(r.RENDERBUFFER,t._samples,a.impl._glInternalFormat,t.width,t.height),r.framebufferRenderbuffer(r.FRAMEBUFFER,r.COLOR_ATTACHMENT0,r.RENDERBUFFER,n),r.drawBuffers([r.COLOR_ATTACHMENT0]);let c=r.createFramebuffer();e.setFramebuffer(c),r.framebufferTexture2D(r.FRAMEBUFFER,r.COLOR_ATTACHMENT0,a._cubemap?r.TEXTURE_CUBE_MAP_POSITIVE_X+t._face:r.TEXTURE_2D,a.impl._glTexture,0),this.colorMrtFramebuffers[i]=new Gu(o,c)}}_checkFbo(e,t,s=""){let r=t._colorBuffers?.map(d=>d?.format??-1).join(",")??"",i=t._depth?t._depthBuffer?`dt${t._depthBuffer.format}`:t._stencil?"ds":"d":"",a=`${s}:${r}:${i}:${t._samples}`,o=OR.get(e,()=>{let d=new Set;return d.loseContext=()=>d.clear(),d});if(o.has(a))return;let n=e.gl,c=n.checkFramebufferStatus(n.FRAMEBUFFER),h;switch(c){case n.FRAMEBUFFER_INCOMPLETE_ATTACHMENT:h="FRAMEBUFFER_INCOMPLETE_ATTACHMENT";break;case n.FRAMEBUFFER_INCOMPLETE_MISSING_ATTACHMENT:h="FRAMEBUFFER_INCOMPLETE_MISSING_ATTACHMENT";break;case n.FRAMEBUFFER_INCOMPLETE_DIMENSIONS:h="FRAMEBUFFER_INCOMPLETE_DIMENSIONS";break;case n.FRAMEBUFFER_UNSUPPORTED:h="FRAMEBUFFER_UNSUPPORTED";break}c===n.FRAMEBUFFER_COMPLETE&&o.add(a)}loseContext(){this._glFrameBuffer=null,this._glDepthBuffer=null,this._glResolveFrameBuffer=null,this._glMsaaColorBuffers.length=0,this._glMsaaDepthBuffer=null,this.msaaDepthBufferKey=void 0,this.colorMrtFramebuffers=null,this.suppliedColorFramebuffer=void 0,this._isInitialized=!1}internalResolve(e,t,s,r,i){e.setScissor(0,0,r.width,r.height);let a=e.gl;a.bindFramebuffer(a.READ_FRAMEBUFFER,t),a.bindFramebuffer(a.DRAW_FRAMEBUFFER,s),a.blitFramebuffer(0,0,r.width,r.height,0,0,r.width,r.height,i,a.NEAREST)}resolve(e,t,s,r){let i=e.gl;if(this.colorMrtFramebuffers){if(s)for(let a=0;a<this.colorMrtFramebuffers.length;a++){let o=this.colorMrtFramebuffers[a];this.internalResolve(e,o.msaaFB,o.resolveFB,t,i.COLOR_BUFFER_BIT)}r&&this.internalResolve(e,this._glFrameBuffer,this._glResolveFrameBuffer,t,i.DEPTH_BUFFER_BIT)}else{let a=!!e.defaultFramebuffer&&this._glResolveFrameBuffer===e.defaultFramebuffer;s&&a&&Oe.visionos&&(e.resolveMsaaColorToXrFramebufferViaQuads(this._glFrameBuffer,this._glResolveFrameBuffer,t.width,t.height),s=!1),(s||r)&&this.internalResolve(e,this._glFrameBuffer,this._glResolveFrameBuffer,t,(s?i.COLOR_BUFFER_BIT:0)|(r?i.DEPTH_BUFFER_BIT:0))}i.bindFramebuffer(i.FRAMEBUFFER,this._glFrameBuffer)}};var Bc=class{availablePBOs=[];pendingPBOs=[];constructor(e){this.uploadStream=e,this.useSingleBuffer=e.useSingleBuffer}destroy(){let e=this.uploadStream.device.gl;this.availablePBOs.forEach(t=>e.deleteBuffer(t.pbo)),this.pendingPBOs.forEach(t=>{t.sync&&e.deleteSync(t.sync),e.deleteBuffer(t.pbo)})}_onDeviceLost(){this.availablePBOs.length=0,this.pendingPBOs.length=0}update(e){let t=this.uploadStream.device.gl,s=this.pendingPBOs;for(let i=s.length-1;i>=0;i--){let a=s[i],o=t.clientWaitSync(a.sync,0,0);(o===t.CONDITION_SATISFIED||o===t.ALREADY_SIGNALED)&&(t.deleteSync(a.sync),this.availablePBOs.push({pbo:a.pbo,size:a.size}),s.splice(i,1))}let r=this.availablePBOs;for(let i=r.length-1;i>=0;i--)r[i].size<e&&(t.deleteBuffer(r[i].pbo),r.splice(i,1))}upload(e,t,s,r){this.useSingleBuffer?this.uploadDirect(e,t,s,r):this.uploadPBO(e,t,s,r)}uploadDirect(e,t,s,r){let i=this.uploadStream.device,a=i.gl,o=t.impl;i.setTexture(t,0),i.activeTexture(0),i.bindTexture(t),i.setUnpackFlipY(!1),i.setUnpackPremultiplyAlpha(!1),i.setUnpackAlignment(e.BYTES_PER_ELEMENT);let n=e;if(o._glPixelType===a.UNSIGNED_BYTE&&e.BYTES_PER_ELEMENT!==1){let c=r*e.BYTES_PER_ELEMENT;n=new Uint8Array(e.buffer,e.byteOffset,c)}a.texImage2D(a.TEXTURE_2D,0,o._glInternalFormat,t.width,t.height,0,o._glFormat,o._glPixelType,n),o._glCreated=!0}uploadPBO(e,t,s,r){let i=this.uploadStream.device,a=i.gl,o=t.width,n=r*e.BYTES_PER_ELEMENT;this.update(n);let c=s/o,h=r/o,d=this.availablePBOs.pop()??{pbo:a.createBuffer(),size:n};a.bindBuffer(a.PIXEL_UNPACK_BUFFER,d.pbo),a.bufferData(a.PIXEL_UNPACK_BUFFER,n,a.STREAM_DRAW),a.bufferSubData(a.PIXEL_UNPACK_BUFFER,0,new Uint8Array(e.buffer,e.byteOffset,n)),a.bindBuffer(a.PIXEL_UNPACK_BUFFER,null),i.setTexture(t,0),i.activeTexture(0),i.bindTexture(t),a.bindBuffer(a.PIXEL_UNPACK_BUFFER,d.pbo),i.setUnpackFlipY(!1),i.setUnpackPremultiplyAlpha(!1),i.setUnpackAlignment(e.BYTES_PER_ELEMENT),a.pixelStorei(a.UNPACK_ROW_LENGTH,0),a.pixelStorei(a.UNPACK_SKIP_ROWS,0),a.pixelStorei(a.UNPACK_SKIP_PIXELS,0);let f=t.impl;a.texSubImage2D(a.TEXTURE_2D,0,0,c,o,h,f._glFormat,f._glPixelType,0),a.bindBuffer(a.PIXEL_UNPACK_BUFFER,null);let u=a.fenceSync(a.SYNC_GPU_COMMANDS_COMPLETE,0);this.pendingPBOs.push({pbo:d.pbo,size:n,sync:u}),a.flush()}};var Uc=class{_presentationLayer=null;_graphicsBinding=null;_cameraFbSource=null;_cameraFbDest=null;constructor(e){this.xrBridge=e}destroy(e){this._graphicsBinding=null,this._presentationLayer=null,this._deleteCameraFramebuffers(e)}_deleteCameraFramebuffers(e){if(this._cameraFbSource){let t=e.gl;t.deleteFramebuffer(this._cameraFbSource),this._cameraFbSource=null,t.deleteFramebuffer(this._cameraFbDest),this._cameraFbDest=null}}beginFrame(e,t){let s=e.session.renderState.baseLayer;this.xrBridge.device.defaultFramebuffer=s?s.framebuffer:null}endFrame(){this.xrBridge.device.defaultFramebuffer=null}get presentationLayer(){return this._presentationLayer}get graphicsBinding(){return this._graphicsBinding}getFramebufferSize(e,t){let s=e.session.renderState.baseLayer;if(!s){t.set(0,0);return}t.set(s.framebufferWidth,s.framebufferHeight)}getViewport(e,t){let s=e.session.renderState.baseLayer;return s?s.getViewport(t):{x:0,y:0,width:0,height:0}}attachPresentation(e,t){let s=this.xrBridge.device;if(this._presentationLayer=new XRWebGLLayer(e,s.gl,{alpha:!0,depth:!0,stencil:!0,framebufferScaleFactor:t.framebufferScaleFactor,antialias:!1}),window.XRWebGLBinding)try{this._graphicsBinding=new XRWebGLBinding(e,s.gl)}catch(r){this.xrBridge._onBindingError?.(r)}e.updateRenderState({baseLayer:this._presentationLayer,depthNear:t.depthNear,depthFar:t.depthFar})}releasePresentation(){this._graphicsBinding=null}syncCameraColorTexture(e,t){if(!this._graphicsBinding)return;let s=this.xrBridge.device,r=s.gl,i=this._graphicsBinding.getCameraImage(e);if(!i)return;this._cameraFbSource||(this._cameraFbSource=r.createFramebuffer(),this._cameraFbDest=r.createFramebuffer());let a=e.width,o=e.height;s.setFramebuffer(this._cameraFbSource),r.framebufferTexture2D(r.FRAMEBUFFER,r.COLOR_ATTACHMENT0,r.TEXTURE_2D,i,0),s.setFramebuffer(this._cameraFbDest),r.framebufferTexture2D(r.FRAMEBUFFER,r.COLOR_ATTACHMENT0,r.TEXTURE_2D,t.impl._glTexture,0),r.bindFramebuffer(r.READ_FRAMEBUFFER,this._cameraFbSource),r.bindFramebuffer(r.DRAW_FRAMEBUFFER,this._cameraFbDest),r.blitFramebuffer(0,o,a,0,0,0,a,o,r.COLOR_BUFFER_BIT,r.NEAREST),s.setFramebuffer(s.defaultFramebuffer)}syncCameraDepthTexture(e,t,s){if(!e?.texture)return;let r=this.xrBridge.device.gl;switch(t.impl._glTexture=e.texture,e.textureType==="texture-array"?t.impl._glTarget=r.TEXTURE_2D_ARRAY:t.impl._glTarget=r.TEXTURE_2D,s){case lt:t.impl._glInternalFormat=r.R32F,t.impl._glPixelType=r.FLOAT,t.impl._glFormat=r.RED;break;case Lt:t.impl._glInternalFormat=r.DEPTH_COMPONENT16,t.impl._glPixelType=r.UNSIGNED_SHORT,t.impl._glFormat=r.DEPTH_COMPONENT;break}t.impl._glCreated=!0}onGraphicsDeviceLost(){let e=this.xrBridge._session;if(!e)return;let t=e.renderState;this._graphicsBinding=null,this._presentationLayer=null,this._cameraFbSource=null,this._cameraFbDest=null,e.updateRenderState({baseLayer:this._presentationLayer,depthNear:t.depthNear,depthFar:t.depthFar})}onGraphicsDeviceRestored(){let e=this.xrBridge;if(!e._session)return;let t=e.device,s=e.eventHandler;setTimeout(()=>{e._session&&t.gl.makeXRCompatible().then(()=>{if(!e._session)return;let r=e._session.renderState;e.attachPresentation(e._session,{framebufferScaleFactor:e._framebufferScaleFactor,depthNear:r.depthNear,depthFar:r.depthFar,onBindingError:e._onBindingError})}).catch(r=>{s.fire("error",r)})},0)}};var NR={type:$s,base:0,count:6,indexed:!0},BR=`
	attribute vec2 vertex_position;
	varying vec2 pcTexCoord;
	void main() {
		gl_Position = vec4(vertex_position, 0.0, 1.0);
		pcTexCoord = vertex_position * 0.5 + 0.5;
	}
`,UR=`
	uniform sampler2D pcSource;
	varying vec2 pcTexCoord;
	void main() {
		gl_FragColor = texture2D(pcSource, pcTexCoord);
	}
`,kc=class{_device;_shader=null;_scratchTex=null;_scratchRt=null;_sourceId=null;constructor(e){this._device=e}_getShader(){if(!this._shader){let e=this._device;this._shader=new be(e,It.createDefinition(e,{name:"XrMsaaCopy",attributes:{vertex_position:le},vertexCode:BR,fragmentCode:UR})),this._sourceId=e.scope.resolve("pcSource")}return this._shader}_ensureScratch(e,t){let s=this._device;this._scratchTex&&(this._scratchTex.width!==e||this._scratchTex.height!==t)&&(this._scratchRt.destroy(),this._scratchRt=null,this._scratchTex.destroy(),this._scratchTex=null),this._scratchTex||(this._scratchTex=se.createDataTexture2D(s,"XrMsaaScratch",e,t,s.backBufferFormat),this._scratchRt=new Le({colorBuffer:this._scratchTex,depth:!1,stencil:!1})),this._scratchRt.impl.initialized||this._scratchRt.impl.init(s,this._scratchRt)}copy(e,t,s,r){this._ensureScratch(s,r);let i=this._device,a=i.gl;a.bindFramebuffer(a.READ_FRAMEBUFFER,e),a.bindFramebuffer(a.DRAW_FRAMEBUFFER,this._scratchRt.impl._glFrameBuffer),a.blitFramebuffer(0,0,s,r,0,0,s,r,a.COLOR_BUFFER_BIT,a.NEAREST),i.setDrawStates(Ve.NOBLEND,Ot.NODEPTH),i.setFramebuffer(t),i.setShader(this._getShader()),i.clearVertexBuffer(),i.setVertexBuffer(i.quadVertexBuffer),this._sourceId.setValue(this._scratchTex);let{vx:o,vy:n,vw:c,vh:h,sx:d,sy:f,sw:u,sh:m}=i;i.setViewport(0,0,s,r),i.setScissor(0,0,s,r),i.draw(NR,i.quadIndexBuffer),i.setViewport(o,n,c,h),i.setScissor(d,f,u,m),i.setFramebuffer(e)}destroy(){this._shader?.destroy(),this._shader=null,this._scratchRt?.destroy(),this._scratchRt=null,this._scratchTex?.destroy(),this._scratchTex=null,this._sourceId=null}};var Vu=class{renderVersion;queries=[];destroy(e){this.queries.forEach(t=>e.deleteQuery(t)),this.queries=null}},Gc=class extends Cc{device;freeQueries=[];frameQueries=[];previousFrameQueries=[];timings=[];constructor(e){super(),this.device=e,this.ext=e.extDisjointTimerQuery}destroy(){this.invalidateTimings(),this.freeQueries.forEach(e=>this.device.gl.deleteQuery(e)),this.frameQueries.forEach(e=>this.device.gl.deleteQuery(e)),this.previousFrameQueries.forEach(e=>e.destroy(this.device.gl)),this.freeQueries=null,this.frameQueries=null,this.previousFrameQueries=null}loseContext(){super.loseContext(),this.freeQueries=[],this.frameQueries=[],this.previousFrameQueries=[]}restoreContext(){this.ext=this.device.extDisjointTimerQuery}getQuery(){return this.freeQueries.pop()??this.device.gl.createQuery()}start(e){if(this.ext){let t=this.getSlot(e),s=this.getQuery();return this.frameQueries[t]=s,this.device.gl.beginQuery(this.ext.TIME_ELAPSED_EXT,s),t}}end(e){e!==void 0&&this.device.gl.endQuery(this.ext.TIME_ELAPSED_EXT)}frameStart(){this.processEnableRequest(),this._enabled&&(this.frameGPUMarkerSlot=this.start("GpuFrame"))}frameEnd(){this._enabled&&this.end(this.frameGPUMarkerSlot)}request(){if(this._enabled){let e=this.ext,t=this.device.gl,s=this.device.renderVersion,r=this.frameQueries;if(r.length>0){this.frameQueries=[];let i=new Vu;i.queries=r,i.renderVersion=s,this.previousFrameQueries.push(i)}if(this.previousFrameQueries.length>0){let i=this.previousFrameQueries[0],a=i.queries,o=a[a.length-1],n=t.getQueryParameter(o,t.QUERY_RESULT_AVAILABLE),c=t.getParameter(e.GPU_DISJOINT_EXT);if(n&&!c){this.previousFrameQueries.shift();let h=this.timings;h.length=0;for(let d=0;d<a.length;d++){let f=a[d],u=t.getQueryParameter(f,t.QUERY_RESULT);h[d]=u*1e-6,this.freeQueries.push(f)}this.report(i.renderVersion,h)}if(c){this.previousFrameQueries.forEach(h=>{this.report(h.renderVersion,null),h.destroy(t)}),this.previousFrameQueries.length=0,this.invalidateTimings(),this.frameAllocations.length=0;return}}super.request(s)}}};var Ea=new Ve,zR=8,HR=new Float32Array(4),WR=new Int32Array(4),XR=new Uint32Array(4),Yo={flags:0,color:[0,0,0,1],depth:1,stencil:0},YR=l=>{switch(l){case Po:return 1;case Do:return 2;default:return 0}},ya=[],jR=new Set(["EXT_color_buffer_float","EXT_texture_filter_anisotropic","WEBGL_debug_renderer_info"]),lg={maxTextureSize:4096,maxCubeMapSize:4096,maxRenderBufferSize:8192,maxTextures:16,maxCombinedTextures:32,maxVertexTextures:16,vertexUniformsCount:256,fragmentUniformsCount:256,maxColorAttachments:4,maxVolumeSize:2048,maxAnisotropy:16,maxSamples:4},qR=100,jo=class extends hc{gl;_defaultFramebuffer=null;_defaultFramebufferChanged=!1;_xrMsaaCopy=null;_readbackCopies=new Set;constructor(e,t={}){super(e,t),t=this.initOptions,this.initTextureUnits(),this.contextLost=!1,this._contextLostHandler=d=>{d.preventDefault(),this.loseContext()},this._contextRestoredHandler=()=>{this.restoreContext()};let s=typeof navigator<"u"&&navigator.userAgent;if(this.forceDisableMultisampling=s&&s.includes("AppleWebKit")&&(s.includes("Version/15.4")||s.includes("OS 15_4")),this.forceDisableMultisampling&&(t.antialias=!1),Oe.browserName==="firefox"){let f=(typeof navigator<"u"?navigator.userAgent:"").match(/Firefox\/(\d+(\.\d+)*)/),u=f?f[1]:null;if(u){let m=parseFloat(u);(Oe.name==="windows"&&(m>=120||m===115)||Oe.name==="android"&&m>=132)&&(t.antialias=!1)}}this.backBufferAntialias=t.antialias??!1,t.antialias=!1;let r=t.gl??e.getContext("webgl2",t);if(!r)throw new Error("WebGL not supported");this.gl=r,this.isWebGL2=!0,this._deviceType=N_,this.updateBackbufferFormat(null);let i=Oe.browserName==="safari";e.addEventListener("webglcontextlost",this._contextLostHandler,!1),e.addEventListener("webglcontextrestored",this._contextRestoredHandler,!1),this.initializeExtensions(),this.initializeCapabilities(),this.initializeRenderState(),this.initializeContextCaches(),this.createBackbuffer(null),this.dynamicBuffers=new bc(this),this.supportsImageBitmap=!i&&typeof ImageBitmap<"u",this._samplerTypes=new Set([r.SAMPLER_2D,r.SAMPLER_CUBE,r.UNSIGNED_INT_SAMPLER_2D,r.INT_SAMPLER_2D,r.SAMPLER_2D_SHADOW,r.SAMPLER_CUBE_SHADOW,r.SAMPLER_3D,r.INT_SAMPLER_3D,r.UNSIGNED_INT_SAMPLER_3D,r.SAMPLER_2D_ARRAY,r.INT_SAMPLER_2D_ARRAY,r.UNSIGNED_INT_SAMPLER_2D_ARRAY]),this.glAddress=[r.REPEAT,r.CLAMP_TO_EDGE,r.MIRRORED_REPEAT],this.glBlendEquation=[r.FUNC_ADD,r.FUNC_SUBTRACT,r.FUNC_REVERSE_SUBTRACT,r.MIN,r.MAX],this.glBlendFunctionColor=[r.ZERO,r.ONE,r.SRC_COLOR,r.ONE_MINUS_SRC_COLOR,r.DST_COLOR,r.ONE_MINUS_DST_COLOR,r.SRC_ALPHA,r.SRC_ALPHA_SATURATE,r.ONE_MINUS_SRC_ALPHA,r.DST_ALPHA,r.ONE_MINUS_DST_ALPHA,r.CONSTANT_COLOR,r.ONE_MINUS_CONSTANT_COLOR,this.extBlendFuncExtended?.SRC1_COLOR_WEBGL,this.extBlendFuncExtended?.ONE_MINUS_SRC1_COLOR_WEBGL,this.extBlendFuncExtended?.SRC1_ALPHA_WEBGL,this.extBlendFuncExtended?.ONE_MINUS_SRC1_ALPHA_WEBGL],this.glBlendFunctionAlpha=[r.ZERO,r.ONE,r.SRC_COLOR,r.ONE_MINUS_SRC_COLOR,r.DST_COLOR,r.ONE_MINUS_DST_COLOR,r.SRC_ALPHA,r.SRC_ALPHA_SATURATE,r.ONE_MINUS_SRC_ALPHA,r.DST_ALPHA,r.ONE_MINUS_DST_ALPHA,r.CONSTANT_ALPHA,r.ONE_MINUS_CONSTANT_ALPHA,this.extBlendFuncExtended?.SRC1_COLOR_WEBGL,this.extBlendFuncExtended?.ONE_MINUS_SRC1_COLOR_WEBGL,this.extBlendFuncExtended?.SRC1_ALPHA_WEBGL,this.extBlendFuncExtended?.ONE_MINUS_SRC1_ALPHA_WEBGL],this.glComparison=[r.NEVER,r.LESS,r.EQUAL,r.LEQUAL,r.GREATER,r.NOTEQUAL,r.GEQUAL,r.ALWAYS],this.glStencilOp=[r.KEEP,r.ZERO,r.REPLACE,r.INCR,r.INCR_WRAP,r.DECR,r.DECR_WRAP,r.INVERT],this.glClearFlag=[0,r.COLOR_BUFFER_BIT,r.DEPTH_BUFFER_BIT,r.COLOR_BUFFER_BIT|r.DEPTH_BUFFER_BIT,r.STENCIL_BUFFER_BIT,r.STENCIL_BUFFER_BIT|r.COLOR_BUFFER_BIT,r.STENCIL_BUFFER_BIT|r.DEPTH_BUFFER_BIT,r.STENCIL_BUFFER_BIT|r.COLOR_BUFFER_BIT|r.DEPTH_BUFFER_BIT],this.glCull=[0,r.BACK,r.FRONT,r.FRONT_AND_BACK],this.glFrontFace=[r.CCW,r.CW],this.glFilter=[r.NEAREST,r.LINEAR,r.NEAREST_MIPMAP_NEAREST,r.NEAREST_MIPMAP_LINEAR,r.LINEAR_MIPMAP_NEAREST,r.LINEAR_MIPMAP_LINEAR],this.glPrimitive=[r.POINTS,r.LINES,r.LINE_LOOP,r.LINE_STRIP,r.TRIANGLES,r.TRIANGLE_STRIP,r.TRIANGLE_FAN],this.glType=[r.BYTE,r.UNSIGNED_BYTE,r.SHORT,r.UNSIGNED_SHORT,r.INT,r.UNSIGNED_INT,r.FLOAT,r.HALF_FLOAT],this.pcUniformType={},this.pcUniformType[r.BOOL]=Zs,this.pcUniformType[r.INT]=ct,this.pcUniformType[r.FLOAT]=b,this.pcUniformType[r.FLOAT_VEC2]=ht,this.pcUniformType[r.FLOAT_VEC3]=Z,this.pcUniformType[r.FLOAT_VEC4]=Pe,this.pcUniformType[r.INT_VEC2]=ls,this.pcUniformType[r.INT_VEC3]=Rt,this.pcUniformType[r.INT_VEC4]=cs,this.pcUniformType[r.BOOL_VEC2]=Pr,this.pcUniformType[r.BOOL_VEC3]=Dr,this.pcUniformType[r.BOOL_VEC4]=Ir,this.pcUniformType[r.FLOAT_MAT2]=di,this.pcUniformType[r.FLOAT_MAT3]=Cs,this.pcUniformType[r.FLOAT_MAT4]=Be,this.pcUniformType[r.SAMPLER_2D]=C_,this.pcUniformType[r.SAMPLER_CUBE]=v_,this.pcUniformType[r.UNSIGNED_INT]=X,this.pcUniformType[r.UNSIGNED_INT_VEC2]=vs,this.pcUniformType[r.UNSIGNED_INT_VEC3]=xs,this.pcUniformType[r.UNSIGNED_INT_VEC4]=Pt,this.pcUniformType[r.SAMPLER_2D_SHADOW]=x_,this.pcUniformType[r.SAMPLER_CUBE_SHADOW]=A_,this.pcUniformType[r.SAMPLER_2D_ARRAY]=P_,this.pcUniformType[r.SAMPLER_3D]=R_,this.pcUniformType[r.INT_SAMPLER_2D]=D_,this.pcUniformType[r.UNSIGNED_INT_SAMPLER_2D]=I_,this.pcUniformType[r.INT_SAMPLER_CUBE]=w_,this.pcUniformType[r.UNSIGNED_INT_SAMPLER_2D]=M_,this.pcUniformType[r.INT_SAMPLER_3D]=L_,this.pcUniformType[r.UNSIGNED_INT_SAMPLER_3D]=b_,this.pcUniformType[r.INT_SAMPLER_2D_ARRAY]=F_,this.pcUniformType[r.UNSIGNED_INT_SAMPLER_2D_ARRAY]=O_,this.targetToSlot={},this.targetToSlot[r.TEXTURE_2D]=0,this.targetToSlot[r.TEXTURE_CUBE_MAP]=1,this.targetToSlot[r.TEXTURE_3D]=2,this.targetToSlot[r.TEXTURE_2D_ARRAY]=3;let a,o,n,c,h;this.commitFunction=[],this.commitFunction[Zs]=function(d,f){d.value!==f&&(r.uniform1i(d.locationId,f),d.value=f)},this.commitFunction[ct]=this.commitFunction[Zs],this.commitFunction[b]=function(d,f){d.value!==f&&(r.uniform1f(d.locationId,f),d.value=f)},this.commitFunction[ht]=function(d,f){h=d.value,a=f[0],o=f[1],(h[0]!==a||h[1]!==o)&&(r.uniform2fv(d.locationId,f),h[0]=a,h[1]=o)},this.commitFunction[Z]=function(d,f){h=d.value,a=f[0],o=f[1],n=f[2],(h[0]!==a||h[1]!==o||h[2]!==n)&&(r.uniform3fv(d.locationId,f),h[0]=a,h[1]=o,h[2]=n)},this.commitFunction[Pe]=function(d,f){h=d.value,a=f[0],o=f[1],n=f[2],c=f[3],(h[0]!==a||h[1]!==o||h[2]!==n||h[3]!==c)&&(r.uniform4fv(d.locationId,f),h[0]=a,h[1]=o,h[2]=n,h[3]=c)},this.commitFunction[ls]=function(d,f){h=d.value,a=f[0],o=f[1],(h[0]!==a||h[1]!==o)&&(r.uniform2iv(d.locationId,f),h[0]=a,h[1]=o)},this.commitFunction[Pr]=this.commitFunction[ls],this.commitFunction[Rt]=function(d,f){h=d.value,a=f[0],o=f[1],n=f[2],(h[0]!==a||h[1]!==o||h[2]!==n)&&(r.uniform3iv(d.locationId,f),h[0]=a,h[1]=o,h[2]=n)},this.commitFunction[Dr]=this.commitFunction[Rt],this.commitFunction[cs]=function(d,f){h=d.value,a=f[0],o=f[1],n=f[2],c=f[3],(h[0]!==a||h[1]!==o||h[2]!==n||h[3]!==c)&&(r.uniform4iv(d.locationId,f),h[0]=a,h[1]=o,h[2]=n,h[3]=c)},this.commitFunction[Ir]=this.commitFunction[cs],this.commitFunction[di]=function(d,f){r.uniformMatrix2fv(d.locationId,!1,f)},this.commitFunction[Cs]=function(d,f){r.uniformMatrix3fv(d.locationId,!1,f)},this.commitFunction[Be]=function(d,f){r.uniformMatrix4fv(d.locationId,!1,f)},this.commitFunction[wr]=function(d,f){r.uniform1fv(d.locationId,f)},this.commitFunction[Mr]=function(d,f){r.uniform2fv(d.locationId,f)},this.commitFunction[Lr]=function(d,f){r.uniform3fv(d.locationId,f)},this.commitFunction[oa]=function(d,f){r.uniform4fv(d.locationId,f)},this.commitFunction[X]=function(d,f){d.value!==f&&(r.uniform1ui(d.locationId,f),d.value=f)},this.commitFunction[vs]=function(d,f){h=d.value,a=f[0],o=f[1],(h[0]!==a||h[1]!==o)&&(r.uniform2uiv(d.locationId,f),h[0]=a,h[1]=o)},this.commitFunction[xs]=function(d,f){h=d.value,a=f[0],o=f[1],n=f[2],(h[0]!==a||h[1]!==o||h[2]!==n)&&(r.uniform3uiv(d.locationId,f),h[0]=a,h[1]=o,h[2]=n)},this.commitFunction[Pt]=function(d,f){h=d.value,a=f[0],o=f[1],n=f[2],c=f[3],(h[0]!==a||h[1]!==o||h[2]!==n||h[3]!==c)&&(r.uniform4uiv(d.locationId,f),h[0]=a,h[1]=o,h[2]=n,h[3]=c)},this.commitFunction[As]=function(d,f){r.uniform1iv(d.locationId,f)},this.commitFunction[br]=function(d,f){r.uniform1uiv(d.locationId,f)},this.commitFunction[Fr]=this.commitFunction[As],this.commitFunction[Rs]=function(d,f){r.uniform2iv(d.locationId,f)},this.commitFunction[Or]=function(d,f){r.uniform2uiv(d.locationId,f)},this.commitFunction[Nr]=this.commitFunction[Rs],this.commitFunction[Ps]=function(d,f){r.uniform3iv(d.locationId,f)},this.commitFunction[Br]=function(d,f){r.uniform3uiv(d.locationId,f)},this.commitFunction[Ur]=this.commitFunction[Ps],this.commitFunction[fi]=function(d,f){r.uniform4iv(d.locationId,f)},this.commitFunction[na]=function(d,f){r.uniform4uiv(d.locationId,f)},this.commitFunction[la]=this.commitFunction[fi],this.commitFunction[Hl]=function(d,f){r.uniformMatrix4fv(d.locationId,!1,f)},this.constantTexSource=this.scope.resolve("source"),this.postInit()}postInit(){super.postInit(),this.gpuProfiler=new Gc(this)}destroy(){super.destroy();for(let t of[...this._readbackCopies])t.abandon();let e=this.gl;this.feedback&&e.deleteTransformFeedback(this.feedback),this.clearVertexArrayObjectCache(),this._xrMsaaCopy?.destroy(),this._xrMsaaCopy=null,this.canvas.removeEventListener("webglcontextlost",this._contextLostHandler,!1),this.canvas.removeEventListener("webglcontextrestored",this._contextRestoredHandler,!1),this._contextLostHandler=null,this._contextRestoredHandler=null,this.gl=null,super.postDestroy()}createBackbuffer(e){this.supportsStencil=this.initOptions.stencil,this.backBuffer=new Le({name:"WebglFramebuffer",graphicsDevice:this,depth:this.initOptions.depth,stencil:this.supportsStencil,samples:this.samples}),this.backBuffer.impl.suppliedColorFramebuffer=e}updateBackbufferFormat(e){let t=this.gl;t.bindFramebuffer(t.FRAMEBUFFER,e);let s=this.gl.getParameter(this.gl.ALPHA_BITS);this.backBufferFormat=s?Re:Co}updateBackbuffer(){let e=this.canvas.width!==this.backBufferSize.x||this.canvas.height!==this.backBufferSize.y;(this._defaultFramebufferChanged||e)&&(this._defaultFramebufferChanged&&this.updateBackbufferFormat(this._defaultFramebuffer),this._defaultFramebufferChanged=!1,this.backBufferSize.set(this.canvas.width,this.canvas.height),this.backBuffer.destroy(),this.createBackbuffer(this._defaultFramebuffer))}createVertexBufferImpl(e,t){return new xc}createIndexBufferImpl(e){return new Ac(e)}createShaderImpl(e){return new Dc(e)}createUniformBufferImpl(e){return new Ic}createBindGroupFormatImpl(e){return new Mc}createBindGroupImpl(e){return new wc}setBindGroup(e,t,s){let r=this.gl,i=t.impl.buffers;for(let a=0;a<i.length;a++)r.bindBufferBase(r.UNIFORM_BUFFER,e,i[a].bufferId)}createDrawCommandImpl(e){return new Fc(e.indexSizeBytes)}createTextureImpl(e){return this.textures.add(e),new Oc(e)}createXrBridgeImpl(e){return new Uc(e)}createRenderTargetImpl(e){return new Nc}createUploadStreamImpl(e){return new Bc(e)}getPrecision(){let e=this.gl,t="highp";if(e.getShaderPrecisionFormat){let s=e.getShaderPrecisionFormat(e.VERTEX_SHADER,e.HIGH_FLOAT),r=e.getShaderPrecisionFormat(e.VERTEX_SHADER,e.MEDIUM_FLOAT),i=e.getShaderPrecisionFormat(e.FRAGMENT_SHADER,e.HIGH_FLOAT),a=e.getShaderPrecisionFormat(e.FRAGMENT_SHADER,e.MEDIUM_FLOAT);if(s&&r&&i&&a){let o=s.precision>0&&i.precision>0,n=r.precision>0&&a.precision>0;o||(n?t="mediump":t="lowp")}}return t}getExtension(){for(let e=0;e<arguments.length;e++)if(this.supportedExtensions.indexOf(arguments[e])!==-1)return this.gl.getExtension(arguments[e]);return null}get extDisjointTimerQuery(){return this._extDisjointTimerQuery||(this._extDisjointTimerQuery=this.getExtension("EXT_disjoint_timer_query_webgl2","EXT_disjoint_timer_query")),this._extDisjointTimerQuery}get bare(){return this.initOptions.deviceType===B_}initializeExtensions(){let e=this.gl;this.supportedExtensions=e.getSupportedExtensions()??[],this._extDisjointTimerQuery=null,this.bare&&(this.supportedExtensions=this.supportedExtensions.filter(t=>jR.has(t))),this.textureRG11B10Renderable=!0,this.extColorBufferFloat=this.getExtension("EXT_color_buffer_float"),this.textureFloatRenderable=!!this.extColorBufferFloat,this.extColorBufferHalfFloat=this.getExtension("EXT_color_buffer_half_float"),this.textureHalfFloatRenderable=!!this.extColorBufferHalfFloat||!!this.extColorBufferFloat,this.extDebugRendererInfo=this.getExtension("WEBGL_debug_renderer_info"),this.extTextureFloatLinear=this.getExtension("OES_texture_float_linear"),this.textureFloatFilterable=!!this.extTextureFloatLinear,this.extFloatBlend=this.getExtension("EXT_float_blend"),this.textureFloatBlendable=!!this.extFloatBlend,this.extBlendFuncExtended=this.getExtension("WEBGL_blend_func_extended"),this.supportsDualSourceBlending=!!this.extBlendFuncExtended,this.extDrawBuffersIndexed=this.getExtension("OES_draw_buffers_indexed"),this.supportsIndependentBlending=!!this.extDrawBuffersIndexed,this.extTextureFilterAnisotropic=this.getExtension("EXT_texture_filter_anisotropic","WEBKIT_EXT_texture_filter_anisotropic"),this.extParallelShaderCompile=this.getExtension("KHR_parallel_shader_compile"),this.extProvokingVertex=this.getExtension("WEBGL_provoking_vertex"),this.extMultiDraw=this.getExtension("WEBGL_multi_draw"),this.supportsMultiDraw=!!this.extMultiDraw,this.extCompressedTextureETC1=this.getExtension("WEBGL_compressed_texture_etc1"),this.extCompressedTextureETC=this.getExtension("WEBGL_compressed_texture_etc"),this.extCompressedTexturePVRTC=this.getExtension("WEBGL_compressed_texture_pvrtc","WEBKIT_WEBGL_compressed_texture_pvrtc"),this.extCompressedTextureS3TC=this.getExtension("WEBGL_compressed_texture_s3tc","WEBKIT_WEBGL_compressed_texture_s3tc"),this.extCompressedTextureS3TC_SRGB=this.getExtension("WEBGL_compressed_texture_s3tc_srgb"),this.extCompressedTextureATC=this.getExtension("WEBGL_compressed_texture_atc"),this.extCompressedTextureASTC=this.getExtension("WEBGL_compressed_texture_astc"),this.extTextureCompressionBPTC=this.getExtension("EXT_texture_compression_bptc"),this.supportsHtmlTextures=!this.bare&&typeof e.texElementImage2D=="function"}initializeCapabilities(){let e=this.gl,t,s=typeof navigator<"u"?navigator.userAgent:"";this.maxPrecision=this.precision=this.getPrecision(),this.maxTextureSize=e.getParameter(e.MAX_TEXTURE_SIZE),this.maxCubeMapSize=e.getParameter(e.MAX_CUBE_MAP_TEXTURE_SIZE),this.maxRenderBufferSize=e.getParameter(e.MAX_RENDERBUFFER_SIZE),this.maxTextures=e.getParameter(e.MAX_TEXTURE_IMAGE_UNITS),this.maxCombinedTextures=e.getParameter(e.MAX_COMBINED_TEXTURE_IMAGE_UNITS),this.maxVertexTextures=e.getParameter(e.MAX_VERTEX_TEXTURE_IMAGE_UNITS),this.vertexUniformsCount=e.getParameter(e.MAX_VERTEX_UNIFORM_VECTORS),this.fragmentUniformsCount=e.getParameter(e.MAX_FRAGMENT_UNIFORM_VECTORS),this.maxColorAttachments=e.getParameter(e.MAX_COLOR_ATTACHMENTS),this.maxVolumeSize=e.getParameter(e.MAX_3D_TEXTURE_SIZE),t=this.extDebugRendererInfo,this.unmaskedRenderer=t?e.getParameter(t.UNMASKED_RENDERER_WEBGL):"",this.unmaskedVendor=t?e.getParameter(t.UNMASKED_VENDOR_WEBGL):"";let r=/\bMali-G52+/,i=/SM-[a-zA-Z0-9]+/;this.supportsGpuParticles=!(this.unmaskedVendor==="ARM"&&s.match(i))&&!this.unmaskedRenderer.match(r),t=this.extTextureFilterAnisotropic,this.maxAnisotropy=t?e.getParameter(t.MAX_TEXTURE_MAX_ANISOTROPY_EXT):1;let a=!this.forceDisableMultisampling;if(this.maxSamples=a?e.getParameter(e.MAX_SAMPLES):1,this.maxSamples=Math.min(this.maxSamples,4),this.bare)for(let o in lg)this[o]=Math.min(this[o],lg[o]);this.samples=a&&this.backBufferAntialias?this.maxSamples:1,this.supportsAreaLights=!Oe.android,this.maxTextures<=8&&(this.supportsAreaLights=!1),this.initCapsDefines()}initializeRenderState(){super.initializeRenderState();let e=this.gl,t=this.extProvokingVertex;t&&t.provokingVertexWEBGL(t.FIRST_VERTEX_CONVENTION_WEBGL),e.disable(e.BLEND),e.blendFunc(e.ONE,e.ZERO),e.blendEquation(e.FUNC_ADD),e.colorMask(!0,!0,!0,!0),e.blendColor(0,0,0,0),e.enable(e.CULL_FACE),this.cullFace=e.BACK,e.cullFace(e.BACK),e.enable(e.DEPTH_TEST),e.depthFunc(e.LEQUAL),e.depthMask(!0),this.stencil=!1,e.disable(e.STENCIL_TEST),this.stencilFuncFront=this.stencilFuncBack=7,this.stencilRefFront=this.stencilRefBack=0,this.stencilMaskFront=this.stencilMaskBack=255,e.stencilFunc(e.ALWAYS,0,255),this.stencilFailFront=this.stencilFailBack=Rr,this.stencilZfailFront=this.stencilZfailBack=Rr,this.stencilZpassFront=this.stencilZpassBack=Rr,this.stencilWriteMaskFront=255,this.stencilWriteMaskBack=255,e.stencilOp(e.KEEP,e.KEEP,e.KEEP),e.stencilMask(255),this.alphaToCoverage=!1,this.raster=!0,e.disable(e.SAMPLE_ALPHA_TO_COVERAGE),e.disable(e.RASTERIZER_DISCARD),this.depthBiasEnabled=!1,e.disable(e.POLYGON_OFFSET_FILL),this.clearDepth=1,e.clearDepth(1),this.clearColor=new z(0,0,0,0),e.clearColor(0,0,0,0),this.clearStencil=0,e.clearStencil(0),e.hint(e.FRAGMENT_SHADER_DERIVATIVE_HINT,e.NICEST),e.enable(e.SCISSOR_TEST),this.textureUnit=0,e.activeTexture(e.TEXTURE0),e.pixelStorei(e.UNPACK_COLORSPACE_CONVERSION_WEBGL,e.NONE),this.unpackFlipY=!1,e.pixelStorei(e.UNPACK_FLIP_Y_WEBGL,!1),this.unpackPremultiplyAlpha=!1,e.pixelStorei(e.UNPACK_PREMULTIPLY_ALPHA_WEBGL,!1),this.unpackAlignment=1,e.pixelStorei(e.UNPACK_ALIGNMENT,1)}initTextureUnits(e=16){this.textureUnits=[];for(let t=0;t<e;t++)this.textureUnits.push([null,null,null,null])}initializeContextCaches(){super.initializeContextCaches(),this._vaoMap=new Map,this.boundVao=null,this.activeFramebuffer=null,this.feedback=null,this.transformFeedbackBuffers=null,this.textureUnit=0,this.initTextureUnits(this.maxCombinedTextures)}isContextLost(){return super.isContextLost()||(this.gl?.isContextLost()??!0)}loseContext(){super.loseContext();for(let e of[...this._readbackCopies])e.fail();for(let e of this.shaders)e.loseContext();this.dynamicBuffers.loseContext(),this.fire("devicelost")}restoreContext(){this.initializeExtensions(),this.initializeCapabilities(),super.restoreContext();for(let e of this.shaders)e.restoreContext();this.updateBackbuffer(),this.fire("devicerestored")}setViewport(e,t,s,r){(this.vx!==e||this.vy!==t||this.vw!==s||this.vh!==r)&&(this.gl.viewport(e,t,s,r),this.vx=e,this.vy=t,this.vw=s,this.vh=r)}setScissor(e,t,s,r){(this.sx!==e||this.sy!==t||this.sw!==s||this.sh!==r)&&(this.gl.scissor(e,t,s,r),this.sx=e,this.sy=t,this.sw=s,this.sh=r)}setFramebuffer(e){if(this.activeFramebuffer!==e){let t=this.gl;t.bindFramebuffer(t.FRAMEBUFFER,e),this.activeFramebuffer=e}}resolveMsaaColorToXrFramebufferViaQuads(e,t,s,r){this._xrMsaaCopy??(this._xrMsaaCopy=new kc(this)),this._xrMsaaCopy.copy(e,t,s,r)}copyRenderTarget(e,t,s,r){let i=this.gl;if(e===this.backBuffer&&(e=null),s){if(t){if(e&&(!e._colorBuffer||!t._colorBuffer||e._colorBuffer._format!==t._colorBuffer._format))return!1}else if(!e._colorBuffer)return!1}if(r&&e&&!e._depth&&(!e._depthBuffer||!t._depthBuffer||e._depthBuffer._format!==t._depthBuffer._format))return!1;let a=this.renderTarget;this.renderTarget=t,this.updateBegin();let o=e?e.impl._glFrameBuffer:this.backBuffer?.impl._glFrameBuffer,n=t?t.impl._glFrameBuffer:this.backBuffer?.impl._glFrameBuffer;i.bindFramebuffer(i.READ_FRAMEBUFFER,o),i.bindFramebuffer(i.DRAW_FRAMEBUFFER,n);let c=e?e.width:t?t.width:this.width,h=e?e.height:t?t.height:this.height;return i.blitFramebuffer(0,0,c,h,0,0,c,h,(s?i.COLOR_BUFFER_BIT:0)|(r?i.DEPTH_BUFFER_BIT:0),i.NEAREST),this.renderTarget=a,i.bindFramebuffer(i.FRAMEBUFFER,a?a.impl._glFrameBuffer:null),!0}copyTextureToTexture(e,t,s={}){let r=this.gl,i=s.sourceMipLevel??0,a=s.destMipLevel??0,o=s.face??0,n=s.sourceX??0,c=s.sourceY??0,h=s.destX??0,d=s.destY??0,f=s.width??Math.max(1,e.width>>i),u=s.height??Math.max(1,e.height>>i),m=s.sourceRenderTarget??new Le({name:"TextureCopySource",colorBuffer:e,depth:!1,face:o,mipLevel:i}),_=this.renderTarget;this.setRenderTarget(m),this.initRenderTarget(m),this.setFramebuffer(m.impl._glFrameBuffer),this.setTexture(t,0);let p=t.cubemap?r.TEXTURE_CUBE_MAP_POSITIVE_X+o:r.TEXTURE_2D;return r.copyTexSubImage2D(p,a,h,d,n,c,f,u),s.sourceRenderTarget||m.destroy(),this.setRenderTarget(_),this.setFramebuffer(_?_.impl._glFrameBuffer:this.backBuffer?.impl._glFrameBuffer),!0}frameStart(){if(super.frameStart(),this._readbackCopies.size>0)for(let e of[...this._readbackCopies])e.run();this.updateBackbuffer(),this.gpuProfiler.frameStart()}frameEnd(){super.frameEnd(),this.gpuProfiler.frameEnd(),this.gpuProfiler.request(),this.dynamicBuffers.onFrameEnd()}startRenderPass(e){let t=e.renderTarget??this.backBuffer;this.renderTarget=t,this.updateBegin();let{width:s,height:r}=t;this.setViewport(0,0,s,r),this.setScissor(0,0,s,r);let i=e.depthStencilOps,a=0;i.clearDepth&&(a|=2,Yo.depth=i.clearDepthValue),i.clearStencil&&(a|=4,Yo.stencil=i.clearStencilValue);let o=t._colorBuffers?.length??0,n=e.colorOps,c=o>1||o===1&&qs(t._colorBuffers[0].format);if(!c&&n?.clear){a|=1;let{clearValue:h}=n,d=Yo.color;d[0]=h.r,d[1]=h.g,d[2]=h.b,d[3]=h.a}if(a!==0&&(Yo.flags=a,this.clear(Yo)),c){let h=this.gl,{colorArrayOps:d}=e,f=!1;for(let u=0;u<o;u++){let m=d[u];if(m?.clear){f||(this.setBlendState(Ve.NOBLEND),f=!0);let{clearValue:_}=m,p=rt.get(t._colorBuffers[u].format),g=p?.isUint?XR:p?.isInt?WR:HR;g[0]=_.r,g[1]=_.g,g[2]=_.b,g[3]=_.a,p?.isUint?h.clearBufferuiv(h.COLOR,u,g):p?.isInt?h.clearBufferiv(h.COLOR,u,g):h.clearBufferfv(h.COLOR,u,g)}}}this.insideRenderPass=!0}endRenderPass(e){this.unbindVertexArray();let t=this.renderTarget,s=e.colorArrayOps.length;if(t){ya.length=0;let r=this.gl;for(let i=0;i<s;i++){let a=e.colorArrayOps[i];a.store||a.resolve||ya.push(r.COLOR_ATTACHMENT0+i)}t!==this.backBuffer&&(e.depthStencilOps.storeDepth||ya.push(r.DEPTH_ATTACHMENT),e.depthStencilOps.storeStencil||ya.push(r.STENCIL_ATTACHMENT)),ya.length>0&&e.fullSizeClearRect&&r.invalidateFramebuffer(r.DRAW_FRAMEBUFFER,ya),s&&e.colorOps?.resolve&&e.samples>1&&t.autoResolve&&t.resolve(!0,!1),t.depthBuffer&&e.depthStencilOps.resolveDepth&&e.samples>1&&t.autoResolve&&t.resolve(!1,!0);for(let i=0;i<s;i++)if(e.colorArrayOps[i].genMipmaps){let o=t._colorBuffers[i];o&&o.impl._glTexture&&o.mipmaps&&(this.activeTexture(this.maxCombinedTextures-1),this.bindTexture(o),this.gl.generateMipmap(o.impl._glTarget))}}this.insideRenderPass=!1}set defaultFramebuffer(e){this._defaultFramebuffer!==e&&(this._defaultFramebuffer=e,this._defaultFramebufferChanged=!0)}get defaultFramebuffer(){return this._defaultFramebuffer}updateBegin(){this.boundVao=null;let e=this.renderTarget??this.backBuffer,t=e.impl;t.initialized||this.initRenderTarget(e),this.setFramebuffer(t._glFrameBuffer)}updateEnd(){this.unbindVertexArray();let e=this.renderTarget;if(e&&e!==this.backBuffer){e._samples>1&&e.autoResolve&&e.resolve();let t=e._colorBuffer;t&&t.impl._glTexture&&t.mipmaps&&(this.activeTexture(this.maxCombinedTextures-1),this.bindTexture(t),this.gl.generateMipmap(t.impl._glTarget))}}setUnpackFlipY(e){if(this.unpackFlipY!==e){this.unpackFlipY=e;let t=this.gl;t.pixelStorei(t.UNPACK_FLIP_Y_WEBGL,e)}}setUnpackPremultiplyAlpha(e){if(this.unpackPremultiplyAlpha!==e){this.unpackPremultiplyAlpha=e;let t=this.gl;t.pixelStorei(t.UNPACK_PREMULTIPLY_ALPHA_WEBGL,e)}}setUnpackAlignment(e){this.unpackAlignment!==e&&(this.unpackAlignment=e,this.gl.pixelStorei(this.gl.UNPACK_ALIGNMENT,e))}activeTexture(e){this.textureUnit!==e&&(this.gl.activeTexture(this.gl.TEXTURE0+e),this.textureUnit=e)}bindTexture(e){let t=e.impl,s=t._glTarget,r=t._glTexture,i=this.textureUnit,a=this.targetToSlot[s];this.textureUnits[i][a]!==r&&(this.gl.bindTexture(s,r),this.textureUnits[i][a]=r)}bindTextureOnUnit(e,t){let s=e.impl,r=s._glTarget,i=s._glTexture,a=this.targetToSlot[r];this.textureUnits[t][a]!==i&&(this.activeTexture(t),this.gl.bindTexture(r,i),this.textureUnits[t][a]=i)}setTextureParameters(e){let t=this.gl,s=e.impl.dirtyParameterFlags,r=e.impl._glTarget;if(s&Vo){let i=e._minFilter;(!e._mipmaps||e._compressed&&e._levels.length===1)&&(i===2||i===3?i=0:(i===4||i===5)&&(i=1)),t.texParameteri(r,t.TEXTURE_MIN_FILTER,this.glFilter[i])}if(s&Wl&&t.texParameteri(r,t.TEXTURE_MAG_FILTER,this.glFilter[e._magFilter]),s&Xl&&t.texParameteri(r,t.TEXTURE_WRAP_S,this.glAddress[e._addressU]),s&Yl&&t.texParameteri(r,t.TEXTURE_WRAP_T,this.glAddress[e._addressV]),s&jl&&t.texParameteri(r,t.TEXTURE_WRAP_R,this.glAddress[e._addressW]),s&ql&&t.texParameteri(r,t.TEXTURE_COMPARE_MODE,e._compareOnRead?t.COMPARE_REF_TO_TEXTURE:t.NONE),s&$l&&t.texParameteri(r,t.TEXTURE_COMPARE_FUNC,this.glComparison[e._compareFunc]),s&Kl){let i=this.extTextureFilterAnisotropic;i&&t.texParameterf(r,i.TEXTURE_MAX_ANISOTROPY_EXT,O.clamp(Math.round(e._anisotropy),1,this.maxAnisotropy))}}setTexture(e,t){let s=e.impl;s._glTexture||s.initialize(this,e),s.dirtyParameterFlags>0||e._needsUpload||e._needsMipmapsUpload?(this.activeTexture(t),this.bindTexture(e),s.dirtyParameterFlags&&(this.setTextureParameters(e),s.dirtyParameterFlags=0),(e._needsUpload||e._needsMipmapsUpload)&&(s.upload(this,e),e._needsUpload=!1,e._needsMipmapsUpload=!1)):this.bindTextureOnUnit(e,t)}_vertexArrayKey(e){let t="";for(let s=0;s<e.length;s++)t+=e[s].vaoKeyPart;return t}removeVertexArrayFromCache(e){if(e.length>1){let t=this._vertexArrayKey(e),s=this._vaoMap.get(t);s&&(this._vaoMap.delete(t),this.gl.deleteVertexArray(s))}}createVertexArray(e){let t,s,r=e.length>1;if(r&&(t=this._vertexArrayKey(e),s=this._vaoMap.get(t)),!s){let i=this.gl;s=i.createVertexArray(),i.bindVertexArray(s),i.bindBuffer(i.ELEMENT_ARRAY_BUFFER,null);let a=!1;for(let o=0;o<e.length;o++){let n=e[o];i.bindBuffer(i.ARRAY_BUFFER,n.impl.bufferId);let c=n.format.elements;for(let h=0;h<c.length;h++){let d=c[h],f=ue[d.name];f===0&&(a=!0),d.asInt?i.vertexAttribIPointer(f,d.numComponents,this.glType[d.dataType],d.stride,d.offset):i.vertexAttribPointer(f,d.numComponents,this.glType[d.dataType],d.normalize,d.stride,d.offset),i.enableVertexAttribArray(f),n.format.instancing&&i.vertexAttribDivisor(f,1)}}i.bindVertexArray(null),i.bindBuffer(i.ARRAY_BUFFER,null),r&&this._vaoMap.set(t,s)}return s}unbindVertexArray(){this.boundVao&&(this.boundVao=null,this.gl.bindVertexArray(null))}setBuffers(e){let t=this.gl,s;if(this.vertexBuffers.length===1){let i=this.vertexBuffers[0];i.impl.vao||(i.impl.vao=this.createVertexArray(this.vertexBuffers)),s=i.impl.vao}else s=this.createVertexArray(this.vertexBuffers);this.boundVao!==s&&(this.boundVao=s,t.bindVertexArray(s));let r=e?e.impl.bufferId:null;t.bindBuffer(t.ELEMENT_ARRAY_BUFFER,r)}_multiDrawLoopFallback(e,t,s,r,i){let a=this.gl,o=i.count;if(t.indexed){let n=s.impl.glFormat,{glCounts:c,glOffsetsBytes:h,glInstanceCounts:d}=i.impl;if(r>0)for(let f=0;f<o;f++)a.drawElementsInstanced(e,c[f],n,h[f],d[f]);else for(let f=0;f<o;f++)a.drawElements(e,c[f],n,h[f])}else{let{glCounts:n,glOffsetsBytes:c,glInstanceCounts:h}=i.impl;if(r>0)for(let d=0;d<o;d++)a.drawArraysInstanced(e,c[d],n[d],h[d]);else for(let d=0;d<o;d++)a.drawArrays(e,c[d],n[d])}}draw(e,t,s,r,i=!0,a=!0,o=0){let n=this.shader;if(n&&(this.activateShader(),this.shaderValid)){let c=this.gl;i&&this.setBuffers(t);let h=0,d=n.impl.samplers;for(let p=0,g=d.length;p<g;p++){let T=d[p],S=T.scopeId.value;if(!S){let x=T.scopeId.name;x==="uSceneDepthMap"&&(S=this.builtInTextures.white),x==="uSceneColorMap"&&(S=this.builtInTextures.pink),S||(S=this.builtInTextures.pink)}if(S instanceof se){let x=S;this.setTexture(x,h),T.slot!==h&&(c.uniform1i(T.locationId,h),T.slot=h),h++}else{T.array.length=0;let x=S.length;for(let C=0;C<x;C++){let E=S[C];this.setTexture(E,h),T.array[C]=h,h++}c.uniform1iv(T.locationId,T.array)}}let f=n.impl.uniforms;for(let p=0,g=f.length;p<g;p++){let T=f[p],S=T.scopeId,x=T.version,C=S.versionObject.version;if(x.globalId!==C.globalId||x.revision!==C.revision){x.globalId=C.globalId,x.revision=C.revision;let E=S.value;E!=null&&this.commitFunction[T.dataType](T,E)}}let u=this.transformFeedbackBuffers;if(u){for(let p=0;p<u.length;p++)c.bindBufferBase(c.TRANSFORM_FEEDBACK_BUFFER,p,u[p].impl.bufferId);c.beginTransformFeedback(c.POINTS)}let m=this.glPrimitive[e.type],_=e.count;if(r)if(this.extMultiDraw){let p=r.impl;if(e.indexed){let g=t.impl.glFormat;s>0?this.extMultiDraw.multiDrawElementsInstancedWEBGL(m,p.glCounts,0,g,p.glOffsetsBytes,0,p.glInstanceCounts,0,r.count):this.extMultiDraw.multiDrawElementsWEBGL(m,p.glCounts,0,g,p.glOffsetsBytes,0,r.count)}else s>0?this.extMultiDraw.multiDrawArraysInstancedWEBGL(m,p.glOffsetsBytes,0,p.glCounts,0,p.glInstanceCounts,0,r.count):this.extMultiDraw.multiDrawArraysWEBGL(m,p.glOffsetsBytes,0,p.glCounts,0,r.count)}else this._multiDrawLoopFallback(m,e,t,s,r);else if(e.indexed){let p=t.impl.glFormat,g=e.base*t.bytesPerIndex;s>0?c.drawElementsInstanced(m,_,p,g,s):c.drawElements(m,_,p,g)}else{let p=e.base;s>0?c.drawArraysInstanced(m,p,_,s):c.drawArrays(m,p,_)}if(u){c.endTransformFeedback();for(let p=0;p<u.length;p++)c.bindBufferBase(c.TRANSFORM_FEEDBACK_BUFFER,p,null)}this._drawCallsPerFrame++}a&&this.clearVertexBuffer()}clear(e){let t=this.defaultClearOptions;e=e||t;let s=e.flags??t.flags;if(s!==0){let r=this.gl;if(s&1){let i=e.color??t.color,a=i[0],o=i[1],n=i[2],c=i[3],h=this.clearColor;(a!==h.r||o!==h.g||n!==h.b||c!==h.a)&&(this.gl.clearColor(a,o,n,c),this.clearColor.set(a,o,n,c)),this.setBlendState(Ve.NOBLEND)}if(s&2){let i=e.depth??t.depth;i!==this.clearDepth&&(this.gl.clearDepth(i),this.clearDepth=i),this.setDepthState(Ot.WRITEDEPTH)}if(s&4){let i=e.stencil??t.stencil;i!==this.clearStencil&&(this.gl.clearStencil(i),this.clearStencil=i),r.stencilMask(255),this.stencilWriteMaskFront=255,this.stencilWriteMaskBack=255}r.clear(this.glClearFlag[s])}}submit(){this.gl.flush()}readPixels(e,t,s,r,i){let a=this.gl;a.readPixels(e,t,s,r,a.RGBA,a.UNSIGNED_BYTE,i)}clientWaitAsync(e,t){let s=this.gl,r=s.fenceSync(s.SYNC_GPU_COMMANDS_COMPLETE,0);return this.submit(),new Promise((i,a)=>{function o(){let n=s.clientWaitSync(r,e,0);n===s.TIMEOUT_EXPIRED?setTimeout(o,t):(s.deleteSync(r),n===s.WAIT_FAILED?a(new Error("webgl clientWaitSync sync failed")):i())}o()})}async readPixelsAsync(e,t,s,r,i,a=!1,o=!1){let n=this.gl,c,h;if(a)c=n.RGBA,h=n.UNSIGNED_BYTE;else{let u=this.renderTarget.colorBuffer?.impl;c=u?._glFormat??n.RGBA,h=u?._glPixelType??n.UNSIGNED_BYTE}let d=n.createBuffer();n.bindBuffer(n.PIXEL_PACK_BUFFER,d),n.bufferData(n.PIXEL_PACK_BUFFER,i.byteLength,n.STREAM_READ),n.readPixels(e,t,s,r,c,h,0),n.bindBuffer(n.PIXEL_PACK_BUFFER,null),await this.clientWaitAsync(0,16);let f=()=>{n.bindBuffer(n.PIXEL_PACK_BUFFER,d),n.getBufferSubData(n.PIXEL_PACK_BUFFER,0,i),n.bindBuffer(n.PIXEL_PACK_BUFFER,null),n.deleteBuffer(d)};if(this._destroyed)return n.deleteBuffer(d),i;if(this.contextLost)throw n.deleteBuffer(d),new Error("Texture read did not complete, as the WebGL context was lost.");return o?(await new Promise((u,m)=>{let _={timer:0,settled:!1,end:p=>{_.settled||(_.settled=!0,clearTimeout(_.timer),this._readbackCopies.delete(_),p())},run:()=>_.end(()=>{f(),u()}),abandon:()=>_.end(u),fail:()=>_.end(()=>{m(new Error("Texture read did not complete, as the WebGL context was lost."))})};_.timer=setTimeout(_.run,qR),this._readbackCopies.add(_)}),i):(f(),i)}readTextureAsync(e,t,s,r,i,a){let o=a.face??0,n=a.mipLevel??0,c=a.renderTarget??new Le({colorBuffer:e,depth:!1,face:o,mipLevel:n}),h=YR(e._format),d=h>0,f=Ul(e._format),u=a.data??new f(et.calcLevelGpuSize(r,i,1,e._format)/f.BYTES_PER_ELEMENT),m=d?new Uint8Array(r*i*4):u;this.setRenderTarget(c),this.initRenderTarget(c),this.setFramebuffer(c.impl._glFrameBuffer),a.immediate&&this.gl.flush();let _=!!a.renderTarget,p=()=>{_||(_=!0,this.off("destroy",p),c.destroy())};return _||this.on("destroy",p),new Promise((g,T)=>{this.readPixelsAsync(t,s,r,i,m,d,a.frequent??!1).then(x=>{if(p(),this._destroyed){T(new Error("Texture read did not complete, as the graphics device was destroyed."));return}if(d){let C=r*i;for(let E=0;E<C;E++)for(let v=0;v<h;v++)u[E*h+v]=x[E*4+v];g(u)}else g(x)}).catch(x=>{p(),T(x)})})}async writeTextureAsync(e,t,s,r,i,a){let o=this.gl,n=e.impl,c=n?._glFormat??o.RGBA,h=n?._glPixelType??o.UNSIGNED_BYTE,d=o.createBuffer();o.bindBuffer(o.PIXEL_UNPACK_BUFFER,d),o.bufferData(o.PIXEL_UNPACK_BUFFER,a,o.STREAM_DRAW),o.bindTexture(o.TEXTURE_2D,n._glTexture),o.texSubImage2D(o.TEXTURE_2D,0,t,s,r,i,c,h,0),o.bindBuffer(o.PIXEL_UNPACK_BUFFER,null),e._needsUpload=!1,e._mipmapsUploaded=!1,await this.clientWaitAsync(0,16)}setAlphaToCoverage(e){this.alphaToCoverage!==e&&(this.alphaToCoverage=e,e?this.gl.enable(this.gl.SAMPLE_ALPHA_TO_COVERAGE):this.gl.disable(this.gl.SAMPLE_ALPHA_TO_COVERAGE))}setTransformFeedbackBuffers(e){let t=this.gl,s=e?.length?e:null,r=this.transformFeedbackBuffers!==null;this.transformFeedbackBuffers=s,s?r||(this.feedback??(this.feedback=t.createTransformFeedback()),t.bindTransformFeedback(t.TRANSFORM_FEEDBACK,this.feedback)):r&&t.bindTransformFeedback(t.TRANSFORM_FEEDBACK,null)}setRaster(e){this.raster!==e&&(this.raster=e,e?this.gl.disable(this.gl.RASTERIZER_DISCARD):this.gl.enable(this.gl.RASTERIZER_DISCARD))}setStencilTest(e){if(this.stencil!==e){let t=this.gl;e?t.enable(t.STENCIL_TEST):t.disable(t.STENCIL_TEST),this.stencil=e}}setStencilFunc(e,t,s){(this.stencilFuncFront!==e||this.stencilRefFront!==t||this.stencilMaskFront!==s||this.stencilFuncBack!==e||this.stencilRefBack!==t||this.stencilMaskBack!==s)&&(this.gl.stencilFunc(this.glComparison[e],t,s),this.stencilFuncFront=this.stencilFuncBack=e,this.stencilRefFront=this.stencilRefBack=t,this.stencilMaskFront=this.stencilMaskBack=s)}setStencilFuncFront(e,t,s){if(this.stencilFuncFront!==e||this.stencilRefFront!==t||this.stencilMaskFront!==s){let r=this.gl;r.stencilFuncSeparate(r.FRONT,this.glComparison[e],t,s),this.stencilFuncFront=e,this.stencilRefFront=t,this.stencilMaskFront=s}}setStencilFuncBack(e,t,s){if(this.stencilFuncBack!==e||this.stencilRefBack!==t||this.stencilMaskBack!==s){let r=this.gl;r.stencilFuncSeparate(r.BACK,this.glComparison[e],t,s),this.stencilFuncBack=e,this.stencilRefBack=t,this.stencilMaskBack=s}}setStencilOperation(e,t,s,r){(this.stencilFailFront!==e||this.stencilZfailFront!==t||this.stencilZpassFront!==s||this.stencilFailBack!==e||this.stencilZfailBack!==t||this.stencilZpassBack!==s)&&(this.gl.stencilOp(this.glStencilOp[e],this.glStencilOp[t],this.glStencilOp[s]),this.stencilFailFront=this.stencilFailBack=e,this.stencilZfailFront=this.stencilZfailBack=t,this.stencilZpassFront=this.stencilZpassBack=s),(this.stencilWriteMaskFront!==r||this.stencilWriteMaskBack!==r)&&(this.gl.stencilMask(r),this.stencilWriteMaskFront=r,this.stencilWriteMaskBack=r)}setStencilOperationFront(e,t,s,r){(this.stencilFailFront!==e||this.stencilZfailFront!==t||this.stencilZpassFront!==s)&&(this.gl.stencilOpSeparate(this.gl.FRONT,this.glStencilOp[e],this.glStencilOp[t],this.glStencilOp[s]),this.stencilFailFront=e,this.stencilZfailFront=t,this.stencilZpassFront=s),this.stencilWriteMaskFront!==r&&(this.gl.stencilMaskSeparate(this.gl.FRONT,r),this.stencilWriteMaskFront=r)}setStencilOperationBack(e,t,s,r){(this.stencilFailBack!==e||this.stencilZfailBack!==t||this.stencilZpassBack!==s)&&(this.gl.stencilOpSeparate(this.gl.BACK,this.glStencilOp[e],this.glStencilOp[t],this.glStencilOp[s]),this.stencilFailBack=e,this.stencilZfailBack=t,this.stencilZpassBack=s),this.stencilWriteMaskBack!==r&&(this.gl.stencilMaskSeparate(this.gl.BACK,r),this.stencilWriteMaskBack=r)}applyBlendState(e,t){let s=this.gl,{blend:r,colorOp:i,alphaOp:a,colorSrcFactor:o,colorDstFactor:n,alphaSrcFactor:c,alphaDstFactor:h}=e;if((!t||t.blend!==r)&&(r?s.enable(s.BLEND):s.disable(s.BLEND)),!t||t.colorOp!==i||t.alphaOp!==a){let d=this.glBlendEquation;s.blendEquationSeparate(d[i],d[a])}(!t||t.colorSrcFactor!==o||t.colorDstFactor!==n||t.alphaSrcFactor!==c||t.alphaDstFactor!==h)&&s.blendFuncSeparate(this.glBlendFunctionColor[o],this.glBlendFunctionColor[n],this.glBlendFunctionAlpha[c],this.glBlendFunctionAlpha[h]),(!t||t.allWrite!==e.allWrite)&&s.colorMask(e.redWrite,e.greenWrite,e.blueWrite,e.alphaWrite)}applyBlendStateIndexed(e,t){let s=this.gl,r=this.extDrawBuffersIndexed,{blend:i,colorOp:a,alphaOp:o,colorSrcFactor:n,colorDstFactor:c,alphaSrcFactor:h,alphaDstFactor:d}=t;i?r.enableiOES(s.BLEND,e):r.disableiOES(s.BLEND,e);let f=this.glBlendEquation;r.blendEquationSeparateiOES(e,f[a],f[o]),r.blendFuncSeparateiOES(e,this.glBlendFunctionColor[n],this.glBlendFunctionColor[c],this.glBlendFunctionAlpha[h],this.glBlendFunctionAlpha[d]),r.colorMaskiOES(e,t.redWrite,t.greenWrite,t.blueWrite,t.alphaWrite)}setBlendState(e){let t=this.blendState;if(!t.equals(e)){if((e.hasAttachmentOverrides||t.hasAttachmentOverrides)&&this.supportsIndependentBlending){e.getAttachment(0,Ea),this.applyBlendState(Ea);let s=Ea.key;if(e.hasAttachmentOverrides){let r=Math.min(zR,this.maxColorAttachments);for(let i=1;i<r;i++)e.getAttachment(i,Ea),Ea.key!==s&&this.applyBlendStateIndexed(i,Ea)}}else this.applyBlendState(e,t);t.copy(e)}}setBlendColor(e,t,s,r){let i=this.blendColor;(e!==i.r||t!==i.g||s!==i.b||r!==i.a)&&(this.gl.blendColor(e,t,s,r),i.set(e,t,s,r))}setStencilState(e,t){e||t?(this.setStencilTest(!0),e===t?(this.setStencilFunc(e.func,e.ref,e.readMask),this.setStencilOperation(e.fail,e.zfail,e.zpass,e.writeMask)):(e??(e=zr.DEFAULT),this.setStencilFuncFront(e.func,e.ref,e.readMask),this.setStencilOperationFront(e.fail,e.zfail,e.zpass,e.writeMask),t??(t=zr.DEFAULT),this.setStencilFuncBack(t.func,t.ref,t.readMask),this.setStencilOperationBack(t.fail,t.zfail,t.zpass,t.writeMask))):this.setStencilTest(!1)}setDepthState(e){let t=this.depthState;if(!t.equals(e)){let s=this.gl,r=e.write;t.write!==r&&s.depthMask(r);let{func:i,test:a}=e;!a&&r&&(a=!0,i=7),t.func!==i&&s.depthFunc(this.glComparison[i]),t.test!==a&&(a?s.enable(s.DEPTH_TEST):s.disable(s.DEPTH_TEST));let{depthBias:o,depthBiasSlope:n}=e;o||n?(this.depthBiasEnabled||(this.depthBiasEnabled=!0,this.gl.enable(this.gl.POLYGON_OFFSET_FILL)),s.polygonOffset(n,o)):this.depthBiasEnabled&&(this.depthBiasEnabled=!1,this.gl.disable(this.gl.POLYGON_OFFSET_FILL)),t.copy(e)}}setCullMode(e){if(this.cullMode!==e){if(e===0)this.gl.disable(this.gl.CULL_FACE);else{this.cullMode===0&&this.gl.enable(this.gl.CULL_FACE);let t=this.glCull[e];this.cullFace!==t&&(this.gl.cullFace(t),this.cullFace=t)}this.cullMode=e}}setFrontFace(e){if(this.frontFace!==e){let t=this.glFrontFace[e];this.gl.frontFace(t),this.frontFace=e}}setShader(e,t=!1){e!==this.shader&&(this.shader=e,this.shaderAsyncCompile=t,this.shaderValid=void 0)}activateShader(){let{shader:e}=this,{impl:t}=e;this.shaderValid===void 0&&(e.failed?this.shaderValid=!1:e.ready||(this.shaderAsyncCompile?t.isLinked(this)?t.finalize(this,e)||(e.failed=!0,this.shaderValid=!1):this.shaderValid=!1:t.finalize(this,e)||(e.failed=!0,this.shaderValid=!1))),this.shaderValid===void 0&&(this.gl.useProgram(t.glProgram),this.shaderValid=!0)}clearVertexArrayObjectCache(){let e=this.gl;this._vaoMap.forEach((t,s,r)=>{e.deleteVertexArray(t)}),this._vaoMap.clear()}set fullscreen(e){e?this.gl.canvas.requestFullscreen():document.exitFullscreen()}get fullscreen(){return!!document.fullscreenElement}debugLoseContext(e=100){}};var zu=class{value;scopeId=null},Ie=class{shader=null;name;parameters=new Map;countX=1;countY;countZ;indirectSlotIndex=-1;indirectBuffer=null;indirectFrameStamp=0;constructor(e,t,s="Unnamed"){this.device=e,this.shader=t,this.name=s,e.supportsCompute&&(this.impl=e.createComputeImpl(this))}setParameter(e,t){let s=this.parameters.get(e);s||(s=new zu,s.scopeId=this.device.scope.resolve(e),this.parameters.set(e,s)),s.value=t}getParameter(e){return this.parameters.get(e)?.value}deleteParameter(e){this.parameters.delete(e)}destroy(){this.impl?.destroy(),this.impl=null}applyParameters(){for(let[,e]of this.parameters)e.scopeId.setValue(e.value)}setupDispatch(e,t,s){this.countX=e,this.countY=t,this.countZ=s,this.indirectSlotIndex=-1,this.indirectBuffer=null}setupIndirectDispatch(e,t=null){this.indirectSlotIndex=e,this.indirectBuffer=t,this.indirectFrameStamp=this.device.renderVersion}static calcDispatchSize(e,t,s=65535){if(e<=s)return t.set(e,1);let r=Math.ceil(e/s);return t.set(Math.ceil(e/r),r)}};var zc=class{device;indexSizeBytes;_maxCount=0;get maxCount(){return this._maxCount}impl=null;_count=1;get count(){return this._count}slotIndex=0;validUntilVersion=Number.MAX_SAFE_INTEGER;multiDraw=!1;constructor(e,t=0){this.device=e,this.indexSizeBytes=t,this.impl=e.createDrawCommandImpl(this)}destroy(){this.impl?.destroy?.(),this.impl=null}allocate(e){this._maxCount=e,this.impl.allocate?.(e)}add(e,t,s,r,i=0,a=0){this.impl.add(e,t,s,r,i,a)}update(e){this._count=e,this.impl.update?.(e)}};function $R(l){this.array[this.index]=l}function KR(l,e){this.array[this.index]=l,this.array[this.index+1]=e}function ZR(l,e,t){this.array[this.index]=l,this.array[this.index+1]=e,this.array[this.index+2]=t}function QR(l,e,t,s){this.array[this.index]=l,this.array[this.index+1]=e,this.array[this.index+2]=t,this.array[this.index+3]=s}function JR(l,e,t){this.array[l]=e[t]}function e0(l,e,t){this.array[l]=e[t],this.array[l+1]=e[t+1]}function t0(l,e,t){this.array[l]=e[t],this.array[l+1]=e[t+1],this.array[l+2]=e[t+2]}function s0(l,e,t){this.array[l]=e[t],this.array[l+1]=e[t+1],this.array[l+2]=e[t+2],this.array[l+3]=e[t+3]}function r0(l,e,t){e[t]=this.array[l]}function i0(l,e,t){e[t]=this.array[l],e[t+1]=this.array[l+1]}function a0(l,e,t){e[t]=this.array[l],e[t+1]=this.array[l+1],e[t+2]=this.array[l+2]}function o0(l,e,t){e[t]=this.array[l],e[t+1]=this.array[l+1],e[t+2]=this.array[l+2],e[t+3]=this.array[l+3]}var Hu=class{constructor(e,t,s){switch(this.index=0,this.numComponents=t.numComponents,s.interleaved?this.array=new fu[t.dataType](e,t.offset):this.array=new fu[t.dataType](e,t.offset,s.vertexCount*t.numComponents),this.stride=t.stride/this.array.constructor.BYTES_PER_ELEMENT,t.numComponents){case 1:this.set=$R,this.getToArray=r0,this.setFromArray=JR;break;case 2:this.set=KR,this.getToArray=i0,this.setFromArray=e0;break;case 3:this.set=ZR,this.getToArray=a0,this.setFromArray=t0;break;case 4:this.set=QR,this.getToArray=o0,this.setFromArray=s0;break}}get(e){return this.array[this.index+e]}set(e,t,s,r){}getToArray(e,t,s){}setFromArray(e,t,s){}},Ca=class{constructor(e){this.vertexBuffer=e,this.vertexFormatSize=e.getFormat().size,this.buffer=this.vertexBuffer.lock(),this.accessors=[],this.element={};let t=this.vertexBuffer.getFormat();for(let s=0;s<t.elements.length;s++){let r=t.elements[s];this.accessors[s]=new Hu(this.buffer,r,t),this.element[r.name]=this.accessors[s]}}next(e=1){let t=0,s=this.accessors,r=this.accessors.length;for(;t<r;){let i=s[t++];i.index+=e*i.stride}}end(){this.vertexBuffer.unlock()}writeData(e,t,s){let r=this.element[e];if(r){s>this.vertexBuffer.numVertices&&(s=this.vertexBuffer.numVertices);let i=r.numComponents;if(this.vertexBuffer.getFormat().interleaved){let a=0;for(let o=0;o<s;o++)r.setFromArray(a,t,o*i),a+=r.stride}else if(t.length>s*i){let a=s*i;if(ArrayBuffer.isView(t))t=t.subarray(0,a),r.array.set(t);else for(let o=0;o<a;o++)r.array[o]=t[o]}else r.array.set(t)}}readData(e,t){let s=this.element[e],r=0;if(s){r=this.vertexBuffer.numVertices;let i,a=s.numComponents,o=r*a;if(this.vertexBuffer.getFormat().interleaved){Array.isArray(t)&&(t.length=0),s.index=0;let n=0;for(i=0;i<r;i++)s.getToArray(n,t,i*a),n+=s.stride}else if(ArrayBuffer.isView(t))t.set(t.length>=o?s.array:s.array.subarray(0,t.length));else for(t.length=0,i=0;i<o;i++)t[i]=s.array[i]}return r}};var gi=class l{static ContentType={AAC:"audio/aac",BASIS:"image/basis",BIN:"application/octet-stream",DDS:"image/dds",FORM_URLENCODED:"application/x-www-form-urlencoded",GIF:"image/gif",GLB:"model/gltf-binary",JPEG:"image/jpeg",JSON:"application/json",MP3:"audio/mpeg",MP4:"audio/mp4",OGG:"audio/ogg",OPUS:'audio/ogg; codecs="opus"',PNG:"image/png",TEXT:"text/plain",WAV:"audio/x-wav",XML:"application/xml"};static ResponseType={TEXT:"text",ARRAY_BUFFER:"arraybuffer",BLOB:"blob",DOCUMENT:"document",JSON:"json"};static binaryExtensions=[".model",".wav",".ogg",".mp3",".mp4",".m4a",".aac",".dds",".basis",".glb",".opus"];static retryDelay=100;withCredentials=!1;_maxConcurrentRequests=128;_activeRequests=0;_sendQueue=[];_sendQueueHead=0;set maxConcurrentRequests(e){this._maxConcurrentRequests=e,this._pump()}get maxConcurrentRequests(){return this._maxConcurrentRequests}get(e,t,s){typeof t=="function"&&(s=t,t={});let r=this.request("GET",e,t,s),{progress:i}=t;if(i){let a=n=>{n.lengthComputable&&i.fire("progress",n.loaded,n.total)},o=n=>{a(n),r.removeEventListener("loadstart",a),r.removeEventListener("progress",a),r.removeEventListener("loadend",o)};r.addEventListener("loadstart",a),r.addEventListener("progress",a),r.addEventListener("loadend",o)}return r}post(e,t,s,r){return typeof s=="function"&&(r=s,s={}),s.postdata=t,this.request("POST",e,s,r)}put(e,t,s,r){return typeof s=="function"&&(r=s,s={}),s.postdata=t,this.request("PUT",e,s,r)}del(e,t,s){return typeof t=="function"&&(s=t,t={}),this.request("DELETE",e,t,s)}request(e,t,s,r){let i,a,o,n=!1;if(typeof s=="function"&&(r=s,s={}),s.retry&&(s=Object.assign({retries:0,maxRetries:5},s)),s.callback=r,s.async==null&&(s.async=!0),s.headers==null&&(s.headers={}),s.postdata!=null)if(s.postdata instanceof Document)o=s.postdata;else if(s.postdata instanceof FormData)o=s.postdata;else if(s.postdata instanceof Object){let d=s.headers["Content-Type"];switch(d===void 0&&(s.headers["Content-Type"]=l.ContentType.FORM_URLENCODED,d=s.headers["Content-Type"]),d){case l.ContentType.FORM_URLENCODED:{o="";let f=!0;for(let u in s.postdata)if(s.postdata.hasOwnProperty(u)){f?f=!1:o+="&";let m=encodeURIComponent(u),_=encodeURIComponent(s.postdata[u]);o+=`${m}=${_}`}break}default:case l.ContentType.JSON:d==null&&(s.headers["Content-Type"]=l.ContentType.JSON),o=JSON.stringify(s.postdata);break}}else o=s.postdata;if(s.cache===!1){let d=mt();i=new Ui(t),i.query?i.query=`${i.query}&ts=${d}`:i.query=`ts=${d}`,t=i.toString()}s.query&&(i=new Ui(t),a=el(i.getQuery(),s.query),i.setQuery(a),t=i.toString());let c=new XMLHttpRequest;c.open(e,t,s.async),c.withCredentials=s.withCredentials!==void 0?s.withCredentials:this.withCredentials,c.responseType=s.responseType||this._guessResponseType(t);for(let d in s.headers)s.headers.hasOwnProperty(d)&&c.setRequestHeader(d,s.headers[d]);c.onreadystatechange=()=>{this._onReadyStateChange(e,t,s,c)},c.onerror=()=>{this._onError(e,t,s,c),n=!0};let h=()=>{try{c.send(o)}catch(d){this._releaseSlot(c),!n&&typeof s.error=="function"&&s.error(c.status,c,d)}};return this._acquire(c,s,h),c}_guessResponseType(e){let t=new Ui(e),s=oe.getExtension(t.path).toLowerCase();return l.binaryExtensions.indexOf(s)>=0?l.ResponseType.ARRAY_BUFFER:s===".json"?l.ResponseType.JSON:s===".xml"?l.ResponseType.DOCUMENT:l.ResponseType.TEXT}_isBinaryContentType(e){return[l.ContentType.BASIS,l.ContentType.BIN,l.ContentType.DDS,l.ContentType.GLB,l.ContentType.MP3,l.ContentType.MP4,l.ContentType.OGG,l.ContentType.OPUS,l.ContentType.WAV].indexOf(e)>=0}_isBinaryResponseType(e){return e===l.ResponseType.ARRAY_BUFFER||e===l.ResponseType.BLOB||e===l.ResponseType.JSON}_onReadyStateChange(e,t,s,r){if(r.readyState===4){let i=r.status;if(i===0){let a=r.responseURL;a&&!a.startsWith("http:")&&!a.startsWith("https:")?this._onSuccess(e,t,s,r):this._onError(e,t,s,r)}else i>=200&&i<300||i===304?this._onSuccess(e,t,s,r):this._onError(e,t,s,r)}}_onSuccess(e,t,s,r){this._releaseSlot(r);let i,a,o=r.getResponseHeader("Content-Type");o&&(a=o.split(";")[0].trim());try{r.status===204||r.status===205?i=null:this._isBinaryContentType(a)||this._isBinaryResponseType(r.responseType)?i=r.response:a===l.ContentType.JSON||t.split("?")[0].endsWith(".json")?i=JSON.parse(r.responseText):r.responseType===l.ResponseType.DOCUMENT||a===l.ContentType.XML?i=r.responseXML:i=r.responseText,s.callback(null,i)}catch(n){s.callback(n)}}_onError(e,t,s,r){if(this._releaseSlot(r),!s.retrying)if(s.retry&&s.retries<s.maxRetries){s.retries++,s.retrying=!0;let i=O.clamp(Math.pow(2,s.retries)*l.retryDelay,0,s.maxRetryDelay||5e3);console.log(`${e}: ${t} - Error ${r.status}. Retrying in ${i} ms`),setTimeout(()=>{s.retrying=!1,this.request(e,t,s,s.callback)},i)}else s.callback(r.status===0?"Network error":r.status,null)}_acquire(e,t,s){let r=this._maxConcurrentRequests,i=r>0&&Number.isFinite(r)&&t.async!==!1;!i||this._activeRequests<r?(i&&(this._activeRequests++,e._slotHeld=!0),s()):this._sendQueue.push({xhr:e,send:s})}_releaseSlot(e){e._slotHeld&&(e._slotHeld=!1,this._activeRequests--,this._pump())}_pump(){let e=this._maxConcurrentRequests;if(e>0&&Number.isFinite(e))for(;this._sendQueueHead<this._sendQueue.length&&this._activeRequests<e;){let{xhr:s,send:r}=this._sendQueue[this._sendQueueHead++];this._activeRequests++,s._slotHeld=!0,r()}else for(;this._sendQueueHead<this._sendQueue.length;)this._sendQueue[this._sendQueueHead++].send();this._sendQueueHead===this._sendQueue.length?(this._sendQueue.length=0,this._sendQueueHead=0):this._sendQueueHead>256&&(this._sendQueue=this._sendQueue.slice(this._sendQueueHead),this._sendQueueHead=0)}},Zt=new gi,cg=()=>Zt.withCredentials?"include":"same-origin";var Wu=0,ir=1,va=2,tt=3,fs=4,Xu=5,qo=6,Yu=7,ju=8,qu=9,$u=10,hg={[Wu]:"SUBTRACTIVE",[ir]:"ADDITIVE",[va]:"NORMAL",[tt]:"NONE",[fs]:"PREMULTIPLIED",[Xu]:"MULTIPLICATIVE",[qo]:"ADDITIVEALPHA",[Yu]:"MULTIPLICATIVE2X",[ju]:"SCREEN",[qu]:"MIN",[$u]:"MAX"},Is="none";var n0=0,$o=2,dg={[n0]:"NONE",[$o]:"SCHLICK"};var fg=15,xa=0,it=1,Aa=2,Ra=3,Pa=4,te=0,ze=1;var Ue=2;var Hc={[te]:"DIRECTIONAL",[ze]:"OMNI",[Ue]:"SPOT"},ug=100,Qt=0,Ku=1,Zu=2,Qu=3,mg={[Qt]:"PUNCTUAL",[Ku]:"RECT",[Zu]:"DISK",[Qu]:"SPHERE"},l0=0,c0=1,pg={[l0]:"LINEAR",[c0]:"INVERSESQUARED"},Ko=0;var h0=2;var Ju=3;var d0=4;var f0=5;var Wc=6,u0=7,m0=8,p0=9,Jt=new Map([[f0,{name:"PCF1_32F",kind:"PCF1",format:Lt,pcf:!0}],[Ko,{name:"PCF3_32F",kind:"PCF3",format:Lt,pcf:!0}],[d0,{name:"PCF5_32F",kind:"PCF5",format:Lt,pcf:!0}],[u0,{name:"PCF1_16F",kind:"PCF1",format:js,pcf:!0}],[m0,{name:"PCF3_16F",kind:"PCF3",format:js,pcf:!0}],[p0,{name:"PCF5_16F",kind:"PCF5",format:js,pcf:!0}],[h0,{name:"VSM_16F",kind:"VSM",format:ge,vsm:!0}],[Ju,{name:"VSM_32F",kind:"VSM",format:We,vsm:!0}],[Wc,{name:"PCSS_32F",kind:"PCSS",format:lt,pcss:!0}]]);var _g=255;var gg=1;var ws=0,Bt=1,Si=0,Ti=1,Zo=2,Qo=0,_0=1,Sg={[Qo]:"NONE",[_0]:"BOX"},em="mul";var Jo=0,Wr=1,Tg={[Jo]:"NONE",[Wr]:"SRGB"},Eg=0;var Xr=6,Xc=["LINEAR","FILMIC","HEJL","ACES","ACES2","NEUTRAL","NONE"],g0=0,tm=1,S0=2,yg={[g0]:"NONE",[tm]:"AO",[S0]:"GLOSSDEPENDENT"},es="none",Da="envAtlas",Ia="envAtlasHQ",wa="cubeMap",sm="sphereMap",Cg={[es]:"NONE",[Da]:"ENVATLAS",[Ia]:"ENVATLASHQ",[wa]:"CUBEMAP",[sm]:"SPHEREMAP"},en="ambientSH",tn="envAtlas",sn="constant",vg={[en]:"AMBIENTSH",[tn]:"ENVALATLAS",[sn]:"CONSTANT"},Ei=1,ar=2,xg=4,Ag=8,Yc=16,us=32,jc=64,qc=128,yi=256,Ma=512,or=1024,nr=2048,$c=4096,lr=8192,Yr=16384,rn=32768,cr=24,ms=0,Ci=1;var Tt=1,La=2,rm=4,Kc=Tt|La,jr=0,ps=1,Rg=2,vi=3,im=4;var am=0,an=1,on=2,Pg={[am]:"SIMPLE",[an]:"SLICED",[on]:"TILED"};var Dg=1,ba=0;var Fa=0,Ig=1,om=2,Zc=3,wg=4,Mg=5,nm=0,Lg=1;var qr="infinite",bg="box",Fg="dome",Ut="none",T0="bayer2",E0="bayer4",y0="bayer8",C0="bayer16",Oa="bluenoise",v0="ignnoise",xi="offset",lm="occlusion",Og={[xi]:"OFFSET",[lm]:"OCCLUSION"},Ai={[Ut]:"NONE",[T0]:"BAYER2",[E0]:"BAYER4",[y0]:"BAYER8",[C0]:"BAYER16",[Oa]:"BLUENOISE",[v0]:"IGNNOISE"},Ng="prerender",Bg="postrender",Ug="prerender:layer",kg="postrender:layer",nn="precull",ln="postcull",Gg="cull:end",Et=1,Ms=2,Na="pcShadowCamera",Qc=0,Ri=1,Vg=2,zg=0,Jc=1,Hg="large",Ba="compact",eh=0,th=1,cn=2,Wg=3,cm="target",sh="limit";var Xg="distance",Ua=0,Pi=1,hn=2,Yg=3,hm=4,dm=5,fm=0,jg=1,um=2,Di="depth",mm={[Di]:"uSceneDepthMap"},rh=["instance_lightMap","texture_dirLightMap"];var $r=class{uniformFormats=[];bindGroupFormats=[];vertexFormat;viewTextures=null;constructor(e,t,s){this.uniformFormats[jt]=e,this.vertexFormat=t,e&&s&&(this.viewTextures=s)}hasUniform(e){return this.getUniformBindGroup(e)>=0}getUniformBindGroup(e){for(let t=0;t<this.uniformFormats.length;t++)if(this.uniformFormats[t]?.get(e))return t;return-1}hasTexture(e){return!!this.getTexture(e)}getTexture(e){for(let t=0;t<this.bindGroupFormats.length;t++){let r=this.bindGroupFormats[t]?.getTexture(e);if(r)return r}return null}debugCheckMeshUniform(e){}getVertexElement(e){return this.vertexFormat?.elements.find(t=>t.name===e)}generateKey(e){let t="",{uniformFormats:s,bindGroupFormats:r}=this;for(let i=0;i<s.length;i++){let a=s[i];a&&(t+=`|u${i}:${a.key}`)}for(let i=0;i<r.length;i++){let a=r[i];a&&(t+=`|b${i}:${a.key}`)}return e.isWebGPU&&(t+=`|v:${this.vertexFormat?.shaderProcessingHashString}`,this.viewTextures&&(t+="|vt")),t}};var qg=new Se;function hr(l){return qg.get(l)}function $g(l,e){qg.get(l,()=>e)}var Ls=class{static definesHash(e){let t=Array.from(e).sort((s,r)=>s[0]>r[0]?1:-1);return $e(JSON.stringify(t))}};var x0=new Se,pm=class{index;name;defines=new Map;constructor(e,t,s={}){this.name=e,this.index=t,Object.assign(this,s),this.buildShaderDefines()}buildShaderDefines(){let e;if(this.isShadow){if(e="SHADOW",this.lightType!==void 0){let t=Jt.get(this.shadowType);(this.lightType===te||!t.vsm&&this.lightType===Ue)&&this.defines.set("PERSPECTIVE_DEPTH",""),this.defines.set("LIGHT_TYPE",`${Hc[this.lightType]}`),this.defines.set("SHADOW_TYPE",`${t.name}`)}}else this.isForward?e="FORWARD":this.index===vi?e="PICK":this.index===im&&(e="PICK",this.defines.set("DEPTH_PICK_PASS",""));e&&this.defines.set(`${e}_PASS`,""),this.defines.set(`${this.name.toUpperCase()}_PASS`,"")}},at=class l{passesNamed=new Map;passesIndexed=[];nextIndex=0;constructor(){let e=(t,s,r)=>{let i=this.allocate(t,r)};e("forward",jr,{isForward:!0}),e("prepass",ps),e("shadow",Rg),e("pick",vi),e("depth_pick",im)}static get(e){return x0.get(e,()=>new l)}allocate(e,t){let s=this.passesNamed.get(e);return s===void 0&&(s=new pm(e,this.nextIndex,t),this.passesNamed.set(s.name,s),this.passesIndexed[s.index]=s,this.nextIndex++),s}getByIndex(e){return this.passesIndexed[e]}getByName(e){return this.passesNamed.get(e)}};var dn=class extends Map{_validations;_keyDirty=!1;_key="";constructor(e){super(),this._validations=e}set(e,t){return(!this.has(e)||this.get(e)!==t)&&this.markDirty(),super.set(e,t)}add(e,t=!0){for(let[s,r]of Object.entries(e))(t||!this.has(s))&&this.set(s,r);return this}delete(e){let t=this.has(e),s=super.delete(e);return t&&s&&this.markDirty(),s}clear(){this.size>0&&this.markDirty(),super.clear()}markDirty(){this._dirty=!0,this._keyDirty=!0}isDirty(){return this._dirty}resetDirty(){this._dirty=!1}get key(){return this._keyDirty&&(this._keyDirty=!1,this._key=Array.from(this.entries()).sort(([e],[t])=>e<t?-1:e>t?1:0).map(([e,t])=>`${e}=${$e(t)}`).join(",")),this._key}copy(e){for(let t of this.keys())e.has(t)||this.delete(t);for(let[t,s]of e)this.set(t,s);return this}};var A0=new Se,Ee=class l{static _validations=new Map;glsl=new dn(l._validations);wgsl=new dn(l._validations);static get(e,t=ce){let s=A0.get(e,()=>new l);return t===ce?s.glsl:s.wgsl}static registerValidation(e,t){}version="";get useWGSL(){return this.glsl.size===0||this.wgsl.size>0}get key(){return`GLSL:${this.glsl.key}|WGSL:${this.wgsl.key}|API:${this.version}`}isDirty(){return this.glsl.isDirty()||this.wgsl.isDirty()}resetDirty(){this.glsl.resetDirty(),this.wgsl.resetDirty()}copy(e){return this.version=e.version,this.glsl.copy(e.glsl),this.wgsl.copy(e.wgsl),this}};var dr=class{static merge(...e){let t=new Map(e[0]??[]);for(let s=1;s<e.length;s++){let r=e[s];if(r)for(let[i,a]of r)t.set(i,a)}return t}};var _m=class extends Ls{constructor(e,t){super(),this.key=e,this.shaderDefinition=t}generateKey(e){return this.key}createShaderDefinition(e,t){return this.shaderDefinition}},ot=class l{static createShader(e,t){let s=hr(e),r=s.getCachedShader(t.uniqueName);if(!r){let i=e.isWebGPU&&(!!t.vertexWGSL||!!t.vertexChunk)&&(!!t.fragmentWGSL||!!t.fragmentChunk),a=Ee.get(e,i?q:ce),o=t.vertexChunk?a.get(t.vertexChunk):i?t.vertexWGSL:t.vertexGLSL,n=t.fragmentChunk?a.get(t.fragmentChunk):i?t.fragmentWGSL:t.fragmentGLSL,c=dr.merge(a,t.fragmentIncludes),h=dr.merge(a,t.vertexIncludes);r=new be(e,It.createDefinition(e,{name:t.uniqueName,shaderLanguage:i?q:ce,attributes:t.attributes,vertexCode:o,fragmentCode:n,useTransformFeedback:t.useTransformFeedback,vertexIncludes:h,vertexDefines:t.vertexDefines,fragmentIncludes:c,fragmentDefines:t.fragmentDefines,fragmentOutputTypes:t.fragmentOutputTypes,useDualSourceBlending:t.useDualSourceBlending})),s.setCachedShader(t.uniqueName,r)}return r}static getCoreDefines(e,t){let s=new Map(e.defines);return t.cameraShaderParams.defines.forEach((i,a)=>s.set(a,i)),at.get(t.device).getByIndex(t.pass).defines.forEach((i,a)=>s.set(a,i)),t.device.supportsMeshInstanceStorage&&(t.objDefs&(us|Yr|rn))===0&&s.set("MESH_INSTANCE_STORAGE",""),s}static processShader(e,t){let s=e.definition,i=`${s.name??"shader"}-id-${e.id}`,a=new _m(i,s),o="shader",n=hr(e.device);n.register(o,a);let c=n.getProgram(o,{},t);return n.unregister(o),c}static getScreenDepthChunkKey(e){let{sceneDepthMapLinear:t,sceneDepthMapPacked:s,sceneDepthMapReciprocal:r}=e;return t?s?"-linearPacked":r?"-linearReciprocal":"-linear":""}static addScreenDepthChunkDefines(e,t){return e.sceneDepthMapLinear&&(t.set("SCENE_DEPTHMAP_LINEAR",""),e.sceneDepthMapPacked&&t.set("SCENE_DEPTHMAP_PACKED",""),e.sceneDepthMapReciprocal&&t.set("SCENE_DEPTHMAP_RECIPROCAL","")),l.getScreenDepthChunkKey(e)}};var R0={type:$s,base:0,count:6,indexed:!0},fn=new ne,un=new ne,gm=new pi,fr=class{uniformBuffer;bindGroup;constructor(e){let t=e.device;if(this.shader=e,t.usesMeshBindGroups){let s=new $r;this.shader=ot.processShader(e,s);let r=this.shader.meshUniformBufferFormat;r&&(this.uniformBuffer=new Nt(t,r,!1));let i=this.shader.meshBindGroupFormat;this.bindGroup=new bt(t,i)}}destroy(){this.uniformBuffer?.destroy(),this.uniformBuffer=null,this.bindGroup?.destroy(),this.bindGroup=null}render(e,t,s){let r=this.shader.device;e&&(fn.set(r.vx,r.vy,r.vw,r.vh),un.set(r.sx,r.sy,r.sw,r.sh),t=t??e,r.setViewport(e.x,e.y,e.z,e.w),r.setScissor(t.x,t.y,t.z,t.w)),r.setVertexBuffer(r.quadVertexBuffer);let i=this.shader;if(r.setShader(i),r.usesMeshBindGroups){r.setBindGroup(jt,r.emptyBindGroup),r.setBindGroup(er,r.emptyBindGroup);let a=this.bindGroup;a.update(),r.setBindGroup(ui,a);let o=this.uniformBuffer;o?(o.update(gm),r.setBindGroup(mi,gm.bindGroup,gm.offsets)):r.setBindGroup(mi,r.emptyBindGroup)}r.draw(R0,r.quadIndexBuffer,s),e&&(r.setViewport(fn.x,fn.y,fn.z,fn.w),r.setScissor(un.x,un.y,un.z,un.w))}};var ih=class extends ft{constructor(e,t,s,r){super(e),this.quad=t,this.rect=s,this.scissorRect=r}execute(){let{device:e}=this;e.setDrawStates(e.blendState),this.quad.render(this.rect,this.scissorRect)}};var P0=new ne;function ka(l,e,t,s,r,i){let a=new fr(t);s||(s=P0,s.x=0,s.y=0,s.z=e?e.width:l.width,s.w=e?e.height:l.height);let o=new ih(l,a,s,r);o.init(e),o.colorOps.clear=!1,o.depthStencilOps.clearDepth=!1,l.isWebGPU&&e===null&&l.samples>1&&(o.colorOps.store=!0),o.render(),a.destroy()}var D0=0,Kg=(l,e,t)=>{if(ArrayBuffer.isView(e))l.set(t===e.length?e:e.subarray(0,t));else for(let s=0;s<t;s++)l[s]=e[s]},Kr=class{constructor(){this.initDefaults()}initDefaults(){this.recreate=!1,this.verticesUsage=0,this.indicesUsage=0,this.maxVertices=0,this.maxIndices=0,this.vertexCount=0,this.indexCount=0,this.vertexStreamsUpdated=!1,this.indexStreamUpdated=!1,this.vertexStreamDictionary={},this.indices=null}_changeVertexCount(e,t){this.vertexCount||(this.vertexCount=e)}static DEFAULT_COMPONENTS_POSITION=3;static DEFAULT_COMPONENTS_NORMAL=3;static DEFAULT_COMPONENTS_UV=2;static DEFAULT_COMPONENTS_COLORS=4},Sm=class{constructor(e,t,s,r,i){this.data=e,this.componentCount=t,this.dataType=s,this.dataTypeNormalize=r,this.asInt=i}},ts=class l extends ga{indexBuffer=[null];vertexBuffer=null;primitive=[{type:0,base:0,baseVertex:0,count:0}];skin=null;boneAabb=null;_aabbVer=0;_aabb=new J;_geometryData=null;_morph=null;_storageIndex=!1;_storageVertex=!1;constructor(e,t){super(),this.id=D0++,this.device=e,this._storageIndex=t?.storageIndex||!1,this._storageVertex=t?.storageVertex||!1}static fromGeometry(e,t,s={}){let r=new l(e,s),{positions:i,normals:a,tangents:o,colors:n,uvs:c,uvs1:h,blendIndices:d,blendWeights:f,indices:u}=t;return i&&r.setPositions(i),a&&r.setNormals(a),o&&r.setVertexStream(ns,o,4),n&&r.setColors32(n),c&&r.setUvs(0,c),h&&r.setUvs(1,h),d&&r.setVertexStream(Yt,d,4,d.length/4,ci),f&&r.setVertexStream(Xt,f,4),u&&r.setIndices(u),r.update(),r}set morph(e){e!==this._morph&&(this._morph&&this._morph.decRefCount(),this._morph=e,e&&e.incRefCount())}get morph(){return this._morph}set aabb(e){this._aabb=e,this._aabbVer++}get aabb(){return this._aabb}destroy(){let e=this.morph;e&&(this.morph=null,e.refCount<1&&e.destroy()),this.vertexBuffer&&(this.vertexBuffer.destroy(),this.vertexBuffer=null);for(let t=0;t<this.indexBuffer.length;t++)this._destroyIndexBuffer(t);this.indexBuffer.length=0,this._geometryData=null}_destroyIndexBuffer(e){this.indexBuffer[e]&&(this.indexBuffer[e].destroy(),this.indexBuffer[e]=null)}_initBoneAabbs(e){this.boneAabb=[],this.boneUsed=[];let t,s,r,i,a,o=[],n=[],c=this.boneUsed,h=this.skin.boneNames.length,d,f,u;for(let x=0;x<h;x++)o[x]=new y(Number.MAX_VALUE,Number.MAX_VALUE,Number.MAX_VALUE),n[x]=new y(-Number.MAX_VALUE,-Number.MAX_VALUE,-Number.MAX_VALUE);let m=new Ca(this.vertexBuffer),_=m.element[le],p=m.element[Xt],g=m.element[Yt],T=this.vertexBuffer.numVertices;for(let x=0;x<T;x++){for(let C=0;C<4;C++)if(p.array[p.index+C]>0){let v=g.array[g.index+C];if(c[v]=!0,t=_.array[_.index],s=_.array[_.index+1],r=_.array[_.index+2],i=n[v],a=o[v],a.x>t&&(a.x=t),a.y>s&&(a.y=s),a.z>r&&(a.z=r),i.x<t&&(i.x=t),i.y<s&&(i.y=s),i.z<r&&(i.z=r),e){let A=d=t,D=f=s,R=u=r;for(let w=0;w<e.length;w++){let M=e[w],P=M.deltaPositions[x*3],L=M.deltaPositions[x*3+1],G=M.deltaPositions[x*3+2];P<0?A+=P:d+=P,L<0?D+=L:f+=L,G<0?R+=G:u+=G}a.x>A&&(a.x=A),a.y>D&&(a.y=D),a.z>R&&(a.z=R),i.x<d&&(i.x=d),i.y<f&&(i.y=f),i.z<u&&(i.z=u)}}m.next()}let S=this.vertexBuffer.getFormat().elements.find(x=>x.name===le);if(S&&S.normalize){let x=(()=>{switch(S.dataType){case li:return C=>Math.max(C/127,-1);case ci:return C=>C/255;case hi:return C=>Math.max(C/32767,-1);case ko:return C=>C/65535;default:return C=>C}})();for(let C=0;C<h;C++)if(c[C]){let E=o[C],v=n[C];E.set(x(E.x),x(E.y),x(E.z)),v.set(x(v.x),x(v.y),x(v.z))}}for(let x=0;x<h;x++){let C=new J;C.setMinMax(o[x],n[x]),this.boneAabb.push(C)}}_initGeometryData(){this._geometryData||(this._geometryData=new Kr,this.vertexBuffer&&(this._geometryData.vertexCount=this.vertexBuffer.numVertices,this._geometryData.maxVertices=this.vertexBuffer.numVertices),this.indexBuffer.length>0&&this.indexBuffer[0]&&(this._geometryData.indexCount=this.indexBuffer[0].numIndices,this._geometryData.maxIndices=this.indexBuffer[0].numIndices))}clear(e,t,s=0,r=0){this._initGeometryData(),this._geometryData.initDefaults(),this._geometryData.recreate=!0,this._geometryData.maxVertices=s,this._geometryData.maxIndices=r,this._geometryData.verticesUsage=e?1:0,this._geometryData.indicesUsage=t?1:0}setVertexStream(e,t,s,r,i=_e,a=!1,o=!1){this._initGeometryData();let n=r||t.length/s;this._geometryData._changeVertexCount(n,e),this._geometryData.vertexStreamsUpdated=!0,this._geometryData.vertexStreamDictionary[e]=new Sm(t,s,i,a,o)}getVertexStream(e,t){let s=0,r=!1;if(this._geometryData){let i=this._geometryData.vertexStreamDictionary[e];if(i){r=!0,s=this._geometryData.vertexCount;let a=s*i.componentCount;if(ArrayBuffer.isView(t))Kg(t,i.data,Math.min(t.length,a));else{t.length=0;for(let o=0;o<a;o++)t[o]=i.data[o]}}}return r||this.vertexBuffer&&(s=new Ca(this.vertexBuffer).readData(e,t)),s}setPositions(e,t=Kr.DEFAULT_COMPONENTS_POSITION,s){this.setVertexStream(le,e,t,s,_e,!1)}setNormals(e,t=Kr.DEFAULT_COMPONENTS_NORMAL,s){this.setVertexStream(ys,e,t,s,_e,!1)}setUvs(e,t,s=Kr.DEFAULT_COMPONENTS_UV,r){this.setVertexStream(qi+e,t,s,r,_e,!1)}setColors(e,t=Kr.DEFAULT_COMPONENTS_COLORS,s){this.setVertexStream(gt,e,t,s,_e,!1)}setColors32(e,t){this.setVertexStream(gt,e,Kr.DEFAULT_COMPONENTS_COLORS,t,ci,!0)}setIndices(e,t){this._initGeometryData(),this._geometryData.indexStreamUpdated=!0,this._geometryData.indices=e,this._geometryData.indexCount=t||e.length}getPositions(e){return this.getVertexStream(le,e)}getNormals(e){return this.getVertexStream(ys,e)}getUvs(e,t){return this.getVertexStream(qi+e,t)}getColors(e){return this.getVertexStream(gt,e)}getIndices(e){let t=0;if(this._geometryData&&this._geometryData.indices){let s=this._geometryData.indices;if(t=this._geometryData.indexCount,ArrayBuffer.isView(e))Kg(e,s,Math.min(e.length,t));else{e.length=0;for(let r=0;r<t;r++)e[r]=s[r]}}else this.indexBuffer.length>0&&this.indexBuffer[0]&&(t=this.indexBuffer[0].readData(e));return t}update(e=$s,t=!0){if(this._geometryData){if(t){let i=this._geometryData.vertexStreamDictionary[le];i&&i.componentCount===3&&(this._aabb.compute(i.data,this._geometryData.vertexCount),this._aabbVer++)}let s=this._geometryData.recreate;this._geometryData.vertexCount>this._geometryData.maxVertices&&(s=!0,this._geometryData.maxVertices=this._geometryData.vertexCount),s&&this.vertexBuffer&&(this.vertexBuffer.destroy(),this.vertexBuffer=null);let r=this._geometryData.recreate;this._geometryData.indexCount>this._geometryData.maxIndices&&(r=!0,this._geometryData.maxIndices=this._geometryData.indexCount),r&&this.indexBuffer.length>0&&this.indexBuffer[0]&&(this.indexBuffer[0].destroy(),this.indexBuffer[0]=null),this._geometryData.vertexStreamsUpdated&&this._updateVertexBuffer(),this._geometryData.indexStreamUpdated&&this._updateIndexBuffer(),this.primitive[0].type=e,this.indexBuffer.length>0&&this.indexBuffer[0]?this._geometryData.indexStreamUpdated&&(this.primitive[0].count=this._geometryData.indexCount,this.primitive[0].indexed=!0):this._geometryData.vertexStreamsUpdated&&(this.primitive[0].count=this._geometryData.vertexCount,this.primitive[0].indexed=!1),this._geometryData.vertexCount=0,this._geometryData.indexCount=0,this._geometryData.vertexStreamsUpdated=!1,this._geometryData.indexStreamUpdated=!1,this._geometryData.recreate=!1,this.updateRenderStates()}}_buildVertexFormat(e){let t=[];for(let s in this._geometryData.vertexStreamDictionary){let r=this._geometryData.vertexStreamDictionary[s];t.push({semantic:s,components:r.componentCount,type:r.dataType,normalize:r.dataTypeNormalize,asInt:r.asInt})}return new ma(this.device,t,e)}_updateVertexBuffer(){if(!this.vertexBuffer){let s=this._geometryData.maxVertices,r=this._buildVertexFormat(s);this.vertexBuffer=new sr(this.device,r,s,{usage:this._geometryData.verticesUsage,storage:this._storageVertex})}let e=new Ca(this.vertexBuffer),t=this._geometryData.vertexCount;for(let s in this._geometryData.vertexStreamDictionary){let r=this._geometryData.vertexStreamDictionary[s];e.writeData(s,r.data,t),delete this._geometryData.vertexStreamDictionary[s]}e.end()}_updateIndexBuffer(){if(this.indexBuffer.length<=0||!this.indexBuffer[0]){let t=this._geometryData.maxVertices,s=t>65535||t===0?2:1,r=this._storageIndex?{storage:!0}:void 0;this.indexBuffer[0]=new Vr(this.device,s,this._geometryData.maxIndices,this._geometryData.indicesUsage,void 0,r)}let e=this._geometryData.indices;e&&(this.indexBuffer[0].writeData(e,this._geometryData.indexCount),this._geometryData.indices=null)}prepareRenderState(e){e===Ti?this.generateWireframe():e===Zo&&(this.primitive[Zo]={type:lu,base:0,baseVertex:0,count:this.vertexBuffer?this.vertexBuffer.numVertices:0,indexed:!1})}updateRenderStates(){this.primitive[Zo]&&this.prepareRenderState(Zo),this.primitive[Ti]&&this.prepareRenderState(Ti)}generateWireframe(){this._destroyIndexBuffer(Ti);let e=this.vertexBuffer.numVertices,t,s;if(this.indexBuffer.length>0&&this.indexBuffer[0]){let i=[[0,1],[1,2],[2,0]],a=this.primitive[Si].base,o=this.primitive[Si].count,n=this.primitive[Si].baseVertex||0,c=this.indexBuffer[Si],h=zo[c.format],d=new h(c.storage),f=new h(o*2),u=new Set,m=0;for(let _=a;_<a+o;_+=3)for(let p=0;p<3;p++){let g=d[_+i[p][0]]+n,T=d[_+i[p][1]]+n,S=g>T?T*e+g:g*e+T;u.has(S)||(u.add(S),f[m++]=g,f[m++]=T)}u.clear(),s=c.format,t=f.slice(0,m)}else{let i=e-e%3,a=i/3*6;s=a>65535?2:1,t=a>65535?new Uint32Array(a):new Uint16Array(a);let o=0;for(let n=0;n<i;n+=3)t[o++]=n,t[o++]=n+1,t[o++]=n+1,t[o++]=n+2,t[o++]=n+2,t[o++]=n}let r=new Vr(this.vertexBuffer.device,s,t.length,0,t.buffer);this.primitive[Ti]={type:wo,base:0,baseVertex:0,count:t.length,indexed:!0},this.indexBuffer[Ti]=r}};var Zg=new N,Tm=new y,Qg=new fe,Em=new fe,Jg=new y,eS=new y,I0=new N,w0=new fe,kt=new y,mn=new N,Gt=new fe,Ga=new fe,tS=new N,ym=new y,ah=new y;function sS(l,e){return l instanceof Function?l:t=>{let s=t[l];return s instanceof Function&&(s=s()),s===e}}function rS(l,e){if(e(l))return l;let t=l._children,s=t.length;for(let r=0;r<s;++r){let i=rS(t[r],e);if(i)return i}return null}var wt=class extends de{name;tags=new Bi(this);localPosition=new y;localRotation=new fe;localScale=new y(1,1,1);localEulerAngles=new y;position=new y;rotation=new fe;eulerAngles=new y;_scale=null;localTransform=new N;_dirtyLocal=!1;_aabbVer=0;_frozen=!1;worldTransform=new N;_dirtyWorld=!1;_worldScaleSign=0;_normalMatrix=new Ss;_dirtyNormal=!0;_right=null;_up=null;_forward=null;_parent=null;_children=[];_graphDepth=0;_enabled=!0;_enabledInHierarchy=!1;scaleCompensation=!1;constructor(e="Untitled"){super(),this.name=e}get right(){return this._right||(this._right=new y),this.getWorldTransform().getX(this._right).normalize()}get up(){return this._up||(this._up=new y),this.getWorldTransform().getY(this._up).normalize()}get forward(){return this._forward||(this._forward=new y),this.getWorldTransform().getZ(this._forward).normalize().mulScalar(-1)}get normalMatrix(){let e=this._normalMatrix;return this._dirtyNormal&&(e.invertMat4(this.getWorldTransform()).transpose(),this._dirtyNormal=!1),e}set enabled(e){this._enabled!==e&&(this._enabled=e,(e&&this._parent?.enabled||!e)&&this._notifyHierarchyStateChanged(this,e))}get enabled(){return this._enabled&&this._enabledInHierarchy}get parent(){return this._parent}get path(){let e=this._parent;if(!e)return"";let t=this.name;for(;e&&e._parent;)t=`${e.name}/${t}`,e=e._parent;return t}get root(){let e=this;for(;e._parent;)e=e._parent;return e}get children(){return this._children}getChildren(){return this.children}getName(){return this.name}getPath(){return this.path}getRoot(){return this.root}getParent(){return this.parent}setName(e){this.name=e}get graphDepth(){return this._graphDepth}_notifyHierarchyStateChanged(e,t){e._onHierarchyStateChanged(t);let s=e._children;for(let r=0,i=s.length;r<i;r++)s[r]._enabled&&this._notifyHierarchyStateChanged(s[r],t)}_onHierarchyStateChanged(e){this._enabledInHierarchy=e,e&&!this._frozen&&this._unfreezeParentToRoot()}_cloneInternal(e){e.name=this.name;let t=this.tags._list;e.tags.clear();for(let s=0;s<t.length;s++)e.tags.add(t[s]);e.localPosition.copy(this.localPosition),e.localRotation.copy(this.localRotation),e.localScale.copy(this.localScale),e.localEulerAngles.copy(this.localEulerAngles),e.position.copy(this.position),e.rotation.copy(this.rotation),e.eulerAngles.copy(this.eulerAngles),e.localTransform.copy(this.localTransform),e._dirtyLocal=this._dirtyLocal,e.worldTransform.copy(this.worldTransform),e._dirtyWorld=this._dirtyWorld,e._dirtyNormal=this._dirtyNormal,e._aabbVer=this._aabbVer+1,e._enabled=this._enabled,e.scaleCompensation=this.scaleCompensation,e._enabledInHierarchy=!1}clone(){let e=new this.constructor;return this._cloneInternal(e),e}copy(e){return e._cloneInternal(this),this}destroy(){this.remove();let e=this._children;for(;e.length;){let t=e.pop();t._parent=null,t.destroy()}this.fire("destroy",this),this.off()}find(e,t){let s=[],r=sS(e,t);return this.forEach(i=>{r(i)&&s.push(i)}),s}findOne(e,t){let s=sS(e,t);return rS(this,s)}findByTag(...e){let t=[],s=(r,i)=>{i&&r.tags.has(...e)&&t.push(r);for(let a=0;a<r._children.length;a++)s(r._children[a],!0)};return s(this,!1),t}findByName(e){return this.findOne("name",e)}findByPath(e){let t=Array.isArray(e)?e:e.split("/"),s=this;for(let r=0,i=t.length;r<i;++r)if(s=s.children.find(a=>a.name===t[r]),!s)return null;return s}forEach(e,t){e.call(t,this);let s=this._children,r=s.length;for(let i=0;i<r;++i)s[i].forEach(e,t)}isDescendantOf(e){let t=this._parent;for(;t;){if(t===e)return!0;t=t._parent}return!1}isAncestorOf(e){return e.isDescendantOf(this)}getEulerAngles(){return this.getWorldTransform().getEulerAngles(this.eulerAngles),this.eulerAngles}getLocalEulerAngles(){return this.localRotation.getEulerAngles(this.localEulerAngles),this.localEulerAngles}getLocalPosition(){return this.localPosition}getLocalRotation(){return this.localRotation}getLocalScale(){return this.localScale}getLocalTransform(){return this._dirtyLocal&&(this.localTransform.setTRS(this.localPosition,this.localRotation,this.localScale),this._dirtyLocal=!1),this.localTransform}getPosition(){return this.getWorldTransform().getTranslation(this.position),this.position}getRotation(){return this.rotation.setFromMat4(this.getWorldTransform()),this.rotation}getScale(){return this._scale||(this._scale=new y),this.getWorldTransform().getScale(this._scale)}getWorldTransform(){return!this._dirtyLocal&&!this._dirtyWorld?this.worldTransform:(this._parent&&this._parent.getWorldTransform(),this._sync(),this.worldTransform)}get worldScaleSign(){return this._worldScaleSign===0&&(this._worldScaleSign=this.getWorldTransform().scaleSign),this._worldScaleSign}remove(){this._parent?.removeChild(this)}reparent(e,t){this.remove(),e&&(t>=0?e.insertChild(this,t):e.addChild(this))}setLocalEulerAngles(e,t,s){this.localRotation.setFromEulerAngles(e,t,s),this._dirtyLocal||this._dirtifyLocal()}setLocalPosition(e,t,s){e instanceof y?this.localPosition.copy(e):this.localPosition.set(e,t,s),this._dirtyLocal||this._dirtifyLocal()}setLocalRotation(e,t,s,r){e instanceof fe?this.localRotation.copy(e):this.localRotation.set(e,t,s,r),this._dirtyLocal||this._dirtifyLocal()}setLocalScale(e,t,s){e instanceof y?this.localScale.copy(e):this.localScale.set(e,t,s),this._dirtyLocal||this._dirtifyLocal()}_dirtifyLocal(){this._dirtyLocal||(this._dirtyLocal=!0,this._dirtyWorld||this._dirtifyWorld())}_unfreezeParentToRoot(){let e=this._parent;for(;e;)e._frozen=!1,e=e._parent}_dirtifyWorld(){this._dirtyWorld||this._unfreezeParentToRoot(),this._dirtifyWorldInternal()}_dirtifyWorldInternal(){if(!this._dirtyWorld){this._frozen=!1,this._dirtyWorld=!0;for(let e=0;e<this._children.length;e++)this._children[e]._dirtyWorld||this._children[e]._dirtifyWorldInternal()}this._dirtyNormal=!0,this._worldScaleSign=0,this._aabbVer++}setPosition(e,t,s){e instanceof y?kt.copy(e):kt.set(e,t,s),this._parent===null?this.localPosition.copy(kt):(mn.copy(this._parent.getWorldTransform()).invert(),mn.transformPoint(kt,this.localPosition)),this._dirtyLocal||this._dirtifyLocal()}setRotation(e,t,s,r){if(e instanceof fe?Gt.copy(e):Gt.set(e,t,s,r),this._parent===null)this.localRotation.copy(Gt);else{let i=this._parent.getRotation();Ga.copy(i).invert(),this.localRotation.copy(Ga).mul(Gt)}this._dirtyLocal||this._dirtifyLocal()}setPositionAndRotation(e,t){if(this._parent===null)this.localPosition.copy(e),this.localRotation.copy(t);else{let s=this._parent.getWorldTransform();mn.copy(s).invert(),mn.transformPoint(e,this.localPosition),this.localRotation.setFromMat4(mn).mul(t)}this._dirtyLocal||this._dirtifyLocal()}setEulerAngles(e,t,s){if(this.localRotation.setFromEulerAngles(e,t,s),this._parent!==null){let r=this._parent.getRotation();Ga.copy(r).invert(),this.localRotation.mul2(Ga,this.localRotation)}this._dirtyLocal||this._dirtifyLocal()}addChild(e){this._prepareInsertChild(e),this._children.push(e),this._onInsertChild(e)}addChildAndSaveTransform(e){let t=e.getPosition(),s=e.getRotation();this._prepareInsertChild(e),e.setPosition(I0.copy(this.worldTransform).invert().transformPoint(t)),e.setRotation(w0.copy(this.getRotation()).invert().mul(s)),this._children.push(e),this._onInsertChild(e)}insertChild(e,t){this._prepareInsertChild(e),this._children.splice(t,0,e),this._onInsertChild(e)}_prepareInsertChild(e){e.remove()}_fireOnHierarchy(e,t,s){this.fire(e,s);for(let r=0;r<this._children.length;r++)this._children[r]._fireOnHierarchy(t,t,s)}_onInsertChild(e){e._parent=this;let t=e._enabled&&this.enabled;e._enabledInHierarchy!==t&&(e._enabledInHierarchy=t,e._notifyHierarchyStateChanged(e,t)),e._updateGraphDepth(),e._dirtifyWorld(),this._frozen&&e._unfreezeParentToRoot(),e._fireOnHierarchy("insert","inserthierarchy",this),this.fire&&this.fire("childinsert",e)}_updateGraphDepth(){this._graphDepth=this._parent?this._parent._graphDepth+1:0;for(let e=0,t=this._children.length;e<t;e++)this._children[e]._updateGraphDepth()}removeChild(e){let t=this._children.indexOf(e);t!==-1&&(this._children.splice(t,1),e._parent=null,e._fireOnHierarchy("remove","removehierarchy",this),this.fire("childremove",e))}_sync(){if(this._dirtyLocal&&(this.localTransform.setTRS(this.localPosition,this.localRotation,this.localScale),this._dirtyLocal=!1),this._dirtyWorld){if(this._parent===null)this.worldTransform.copy(this.localTransform);else if(this.scaleCompensation){let e,t=this._parent,s=this.localScale,r=t;if(r){for(;r&&r.scaleCompensation;)r=r._parent;r&&(r=r._parent,r&&(e=r.worldTransform.getScale(),Jg.mul2(e,this.localScale),s=Jg))}Em.setFromMat4(t.worldTransform),Qg.mul2(Em,this.localRotation);let i=t.worldTransform;t.scaleCompensation&&(eS.mul2(e,t.getLocalScale()),Zg.setTRS(t.worldTransform.getTranslation(Tm),Em,eS),i=Zg),i.transformPoint(this.localPosition,Tm),this.worldTransform.setTRS(Tm,Qg,s)}else this.worldTransform.mulAffine2(this._parent.worldTransform,this.localTransform);this._dirtyWorld=!1}}syncHierarchy(){if(!this._enabled||this._frozen)return;this._frozen=!0,(this._dirtyLocal||this._dirtyWorld)&&this._sync();let e=this._children;for(let t=0,s=e.length;t<s;t++)e[t].syncHierarchy()}lookAt(e,t,s,r=0,i=1,a=0){if(e instanceof y)ym.copy(e),t instanceof y?ah.copy(t):ah.copy(y.UP);else{if(s===void 0)return;ym.set(e,t,s),ah.set(r,i,a)}tS.setLookAt(this.getPosition(),ym,ah),Gt.setFromMat4(tS),this.setRotation(Gt)}translate(e,t,s){e instanceof y?kt.copy(e):kt.set(e,t,s),kt.add(this.getPosition()),this.setPosition(kt)}translateLocal(e,t,s){e instanceof y?kt.copy(e):kt.set(e,t,s),this.localRotation.transformVector(kt,kt),this.localPosition.add(kt),this._dirtyLocal||this._dirtifyLocal()}rotate(e,t,s){if(Gt.setFromEulerAngles(e,t,s),this._parent===null)this.localRotation.mul2(Gt,this.localRotation);else{let r=this.getRotation(),i=this._parent.getRotation();Ga.copy(i).invert(),Gt.mul2(Ga,Gt),this.localRotation.mul2(Gt,r)}this._dirtyLocal||this._dirtifyLocal()}rotateLocal(e,t,s){Gt.setFromEulerAngles(e,t,s),this.localRotation.mul(Gt),this._dirtyLocal||this._dirtifyLocal()}};var iS=new Se;function Va(l){return iS.get(l)}function aS(l,e){iS.get(l,()=>e)}var oh=class{cache=new Map;destroy(){this.cache.forEach((e,t)=>{t.destroy()}),this.cache.clear()}incRef(e){let t=(this.cache.get(e)||0)+1;this.cache.set(e,t)}decRef(e){if(e){let t=this.cache.get(e);t&&(t--,t===0?(this.cache.delete(e),e.destroy()):this.cache.set(e,t))}}};var pn=class{static cache=new oh;static incRef(e){this.cache.incRef(e)}static decRef(e){this.cache.decRef(e)}static destroy(){this.cache.destroy()}};var oS={equals(l,e){if(l.length!==e.length)return!1;for(let t=0;t<l.length;t++)if(l[t]!==e[t])return!1;return!0}};var za=class{_counter=0;get(){return this._counter++}};var nh=new za;var lS=["clusterWorldTexture","lightsTexture","shadowAtlasTexture","cookieAtlasTexture","scene_envAtlas","scene_skybox","areaLightsLutTex1","areaLightsLutTex2","blueNoiseTex32","uSceneDepthMap","uSceneColorMap","ssaoTexture"],W1=new Set(lS);var nS=new WeakMap,cS=l=>{if(!l)return null;let e=nS.get(l);if(!e){e=new Set(lS);for(let t=0;l.get(`light${t}_color`);t++)e.add(`light${t}_shadowMap`),e.add(`light${t}_cookie`);nS.set(l,e)}return e};var M0=new J,lh=new J,Cm=new Set,Ii=new Uint32Array(5),ch=class{vertexBuffer=null;_destroyVertexBuffer=!1;constructor(e){this.count=e}destroy(){this._destroyVertexBuffer&&this.vertexBuffer?.destroy(),this.vertexBuffer=null}},vm=class{shader;bindGroup=null;uniformBuffer=null;hashes;getBindGroup(e){if(!this.bindGroup){let s=this.shader.meshBindGroupFormat;this.bindGroup=new bt(e,s)}return this.bindGroup}getUniformBuffer(e){if(!this.uniformBuffer){let s=this.shader.meshUniformBufferFormat;this.uniformBuffer=new Nt(e,s,!1)}return this.uniformBuffer}destroy(){this.bindGroup?.destroy(),this.bindGroup=null,this.uniformBuffer?.destroy(),this.uniformBuffer=null}},nt=class l{castShadow=!1;shadowCascadeMask=_g;cull=!0;drawOrder=0;_drawBucket=127;_node;visible=!0;shaderPassMask=4294967295;visibleThisFrame=!1;flipFacesFactor=1;gsplatInstance=null;id=nh.get();isVisibleFunc=null;instancingData=null;drawCommands=null;meshMetaData=null;parameters=new Map;_scopeParameters=[];_materialOverrides=[];_materialTextureOverrides=[];_materialLayoutVersion=-1;_materialOverridesVersion=0;_materialUniformBuffer=null;_materialBindGroup=null;_syncedMaterialDataVersion=-1;_syncedOverridesVersion=-1;pick=!0;stencilFront=null;stencilBack=null;transparent=!1;_aabb=new J;_aabbVer=-1;_aabbMeshVer=-1;storageSlot=-1;storageSlotVersion=-1;_customAabb=null;_updateAabb=!0;_updateAabbFunc=null;_sortKeyShadow=0;_sortKeyForward=0;_sortKeyDynamic=0;_layer=fg;_material=null;_skinInstance=null;_morphInstance=null;_receiveShadow=!0;_renderStyle=Si;_screenSpace=!1;_shaderCache=new Map;_shaderDefs=Tt<<cr;_calculateSortDistance=null;constructor(e,t,s=null){if(this.node=s,this._mesh=e,e.incRefCount(),this.material=t,e.vertexBuffer){let r=e.vertexBuffer.format;this._shaderDefs|=r.hasUv(0)?xg:0,this._shaderDefs|=r.hasUv(1)?Ag:0,this._shaderDefs|=r.hasColor?Yc:0,this._shaderDefs|=r.hasTangents?Ma:0}this.updateKey()}set node(e){e!==this._node&&(this._node=e,this._aabbVer=-1,this.storageSlotVersion=-1)}get node(){return this._node}set drawBucket(e){this._drawBucket=Math.floor(e)&255,this.updateKey()}get drawBucket(){return this._drawBucket}set renderStyle(e){this._renderStyle=e,this.mesh.prepareRenderState(e)}get renderStyle(){return this._renderStyle}set mesh(e){e!==this._mesh&&(this._mesh&&(!e&&this.storageSlot>=0&&(this._mesh.device.meshInstanceStorage?.free(this.storageSlot),this.storageSlot=-1),this._mesh.decRefCount()),this._mesh=e,e&&e.incRefCount())}get mesh(){return this._mesh}set aabb(e){this._aabb=e}get aabb(){if(!this._updateAabb)return this._aabb;if(this._updateAabbFunc)return this._updateAabbFunc(this._aabb);let e=this._customAabb,t=!!e;if(!e){if(e=M0,this.skinInstance){if(!this.mesh.boneAabb){let i=this._morphInstance?this._morphInstance.morph._targets:null;this.mesh._initBoneAabbs(i)}let s=this.mesh.boneUsed,r=!0;for(let i=0;i<this.mesh.boneAabb.length;i++)s[i]&&(lh.setFromTransformedAabb(this.mesh.boneAabb[i],this.skinInstance.matrices[i]),r?(r=!1,e.center.copy(lh.center),e.halfExtents.copy(lh.halfExtents)):e.add(lh));t=!0}else if(this.node._aabbVer!==this._aabbVer||this.mesh._aabbVer!==this._aabbMeshVer){if(this.mesh?(e.center.copy(this.mesh.aabb.center),e.halfExtents.copy(this.mesh.aabb.halfExtents)):(e.center.set(0,0,0),e.halfExtents.set(0,0,0)),this.mesh&&this.mesh.morph){let s=this.mesh.morph.aabb;e._expand(s.getMin(),s.getMax())}t=!0,this._aabbVer=this.node._aabbVer,this._aabbMeshVer=this.mesh._aabbVer}}return t&&this._aabb.setFromTransformedAabb(e,this.node.getWorldTransform()),this._aabb}clearShaders(){this._shaderCache.forEach(e=>{e.destroy()}),this._shaderCache.clear()}getShaderInstance(e,t,s,r,i){let a=this._shaderDefs;Ii[0]=e,Ii[1]=t.hash,Ii[2]=a,Ii[3]=r.hash,Ii[4]=this.mesh.vertexBuffer?.format.uvMask??0;let o=ua(Ii),n=this._shaderCache.get(o);if(!n){let c=this._material;if(n=new vm,n.shader=c.variants.get(o),n.hashes=new Uint32Array(Ii),!n.shader){let h=c.getShaderVariant({device:this.mesh.device,scene:s,objDefs:a,cameraShaderParams:r,pass:e,lightList:t,viewUniformFormat:i,vertexFormat:this.mesh.vertexBuffer?.format});c.variants.set(o,h),n.shader=h}this._shaderCache.set(o,n)}return n}set material(e){this.clearShaders();let t=this._material;t&&t.removeMeshInstanceRef(this),this._material=e,this._rebuildParameterLists(),e&&(e.addMeshInstanceRef(this),this.transparent=e.transparent,this.updateKey())}get material(){return this._material}_updateShaderDefs(e){e!==this._shaderDefs&&(this._shaderDefs=e,this.clearShaders())}set calculateSortDistance(e){this._calculateSortDistance=e}get calculateSortDistance(){return this._calculateSortDistance}set receiveShadow(e){this._receiveShadow!==e&&(this._receiveShadow=e,this._updateShaderDefs(e?this._shaderDefs&~Ei:this._shaderDefs|Ei))}get receiveShadow(){return this._receiveShadow}set batching(e){this._updateShaderDefs(e?this._shaderDefs|Yr:this._shaderDefs&~Yr)}get batching(){return(this._shaderDefs&Yr)!==0}set skinInstance(e){this._skinInstance=e,this._updateShaderDefs(e?this._shaderDefs|ar:this._shaderDefs&~ar),this._setupSkinUpdate()}get skinInstance(){return this._skinInstance}set morphInstance(e){this._morphInstance?.destroy(),this._morphInstance=e;let t=this._shaderDefs;t=e&&e.morph.morphPositions?t|or:t&~or,t=e&&e.morph.morphNormals?t|nr:t&~nr,t=e&&e.morph.intRenderFormat?t|lr:t&~lr,this._updateShaderDefs(t)}get morphInstance(){return this._morphInstance}set screenSpace(e){this._screenSpace!==e&&(this._screenSpace=e,this._updateShaderDefs(e?this._shaderDefs|yi:this._shaderDefs&~yi))}get screenSpace(){return this._screenSpace}set key(e){this._sortKeyForward=e}get key(){return this._sortKeyForward}set mask(e){let t=this._shaderDefs&(1<<cr)-1;this._updateShaderDefs(t|(e&255)<<cr)}get mask(){return this._shaderDefs>>>cr}set instancingCount(e){this.instancingData&&(this.instancingData.count=e)}get instancingCount(){return this.instancingData?this.instancingData.count:0}destroy(){let e=this.mesh;e&&(this.mesh=null,e.refCount<1&&e.destroy()),this.setRealtimeLightmap(l.lightmapParamNames[0],null),this.setRealtimeLightmap(l.lightmapParamNames[1],null),this._skinInstance?.destroy(),this._skinInstance=null,this.morphInstance?.destroy(),this.morphInstance=null,this.clearShaders(),this._destroyMaterialUniformBuffer(),this.material=null,this.instancingData?.destroy(),this.destroyDrawCommands()}destroyDrawCommands(){if(this.drawCommands){for(let e of this.drawCommands.values())e?.destroy();this.drawCommands=null,this._updateShaderDefs(this._applyInstanceIndexDef(this._shaderDefs))}}_applyInstanceIndexDef(e){return!!this.drawCommands||!!this.instancingData&&!this.instancingData.vertexBuffer?e|rn:e&~rn}static lightmapParamNames=rh;static _prepareRenderStyleForArray(e,t){if(e){for(let s=0;s<e.length;s++){e[s]._renderStyle=t;let r=e[s].mesh;Cm.has(r)||(Cm.add(r),r.prepareRenderState(t))}Cm.clear()}}_isVisible(e){return this.visible?this.isVisibleFunc?this.isVisibleFunc(e):e.frustum.containsAabb(this.aabb):!1}updateKey(){let{material:e}=this;this._sortKeyForward=this._drawBucket<<23|(e.alphaToCoverage||e.alphaTest?4194304:0)|e.id&4194303}setInstancing(e,t=!1){e?(e===!0?this.instancingData=new ch(0):(this.instancingData=new ch(e.numVertices),this.instancingData.vertexBuffer=e,e.format.instancing=!0),this.cull=t):(this.instancingData=null,this.cull=!0),this._updateShaderDefs(this._applyInstanceIndexDef(e instanceof sr?this._shaderDefs|us:this._shaderDefs&~us))}setIndirect(e,t,s=1){let r=e?.camera.id??null;if(t===-1)this._deleteDrawCommandsKey(r);else if(this.mesh.device.supportsIndirectDraw){let i=this._allocDrawCommands(r,!1);i.slotIndex=t,i.update(s),i.validUntilVersion=this.mesh.device.drawCommandsVersion}}setMultiDraw(e,t=1){let s=e?.camera.id??null,r;return t===0?this._deleteDrawCommandsKey(s):(r=this._allocDrawCommands(s,!0),r.allocate(t)),r}_allocDrawCommands(e,t){let s=this.drawCommands??(this.drawCommands=new Map),r=s.get(e);if(r&&r.multiDraw!==t&&(r.destroy(),r=void 0),!r){this._updateShaderDefs(this._applyInstanceIndexDef(this._shaderDefs));let i=0;if(t){let a=this.mesh.indexBuffer?.[0]?.format;i=a!==void 0?f_[a]:0}r=new zc(this.mesh.device,i),r.multiDraw=t,s.set(e,r)}return r}_deleteDrawCommandsKey(e){let t=this.drawCommands;t&&(t.get(e)?.destroy(),t.delete(e),t.size===0&&this.destroyDrawCommands())}getDrawCommands(e){let t=this.drawCommands;if(!t)return;let s=this.mesh.device.drawCommandsVersion,r=t.get(e?.id);if(r&&s<=r.validUntilVersion)return r;let i=t.get(null);return i&&s<=i.validUntilVersion?i:void 0}getIndirectMetaData(){let e=this.mesh?.primitive[this.renderStyle],t=this.meshMetaData??(this.meshMetaData=new Int32Array(4));return t[0]=e.count,t[1]=e.base,t[2]=e.baseVertex,t}ensureMaterial(e){this.material||(this.material=Va(e))}clearParameters(){this.parameters.clear(),this._scopeParameters.length=0,this._materialOverrides.length=0,this._materialTextureOverrides.length=0,this._materialOverridesVersion++}getParameters(){return this.parameters}getParameter(e){return this.parameters.get(e)}setParameter(e,t){let s=this.parameters.get(e);if(s)s.data=t,s.override&&this._materialOverridesVersion++;else{let r={name:e,data:t,scopeId:null,override:!1,uniformFormat:null,textureSlot:-1,replacedValue:void 0};this.parameters.set(e,r),this._addParameter(r)}}setRealtimeLightmap(e,t){let s=this.getParameter(e);s!==t&&(s&&pn.decRef(s.data),t?(pn.incRef(t),this.setParameter(e,t)):this.deleteParameter(e))}deleteParameter(e){let t=this.parameters.get(e);if(t){this.parameters.delete(e);let s=t.override?this._materialOverrides:t.textureSlot>=0?this._materialTextureOverrides:this._scopeParameters;s.splice(s.indexOf(t),1),t.override&&this._materialOverridesVersion++}}setParameters(e){let t=this._scopeParameters;for(let s=0;s<t.length;s++){let r=t[s];r.scopeId||(r.scopeId=e.scope.resolve(r.name)),r.replacedValue=r.scopeId.value,r.scopeId.setValue(r.data)}}restoreReplacedParameters(e){let t=this._scopeParameters,s=e.parameters;for(let r=0;r<t.length;r++){let i=t[r];s[i.name]||i.scopeId.setValue(i.replacedValue)}}_addParameter(e){let t=this._material;e.override=!!t?.getUniformBufferProperty(e.name),e.uniformFormat=null,e.textureSlot=e.override?-1:t?.getTextureSlot(e.name)??-1,e.override?(this._materialOverrides.push(e),this._materialOverridesVersion++):e.textureSlot>=0?this._materialTextureOverrides.push(e):this._scopeParameters.push(e)}_rebuildParameterLists(){this._scopeParameters.length=0,this._materialOverrides.length=0,this._materialTextureOverrides.length=0;for(let e of this.parameters.values())this._addParameter(e);this._materialLayoutVersion=this._material?.layoutVersion??-1,this._materialOverridesVersion++}getMaterialBindGroup(e){let t=this._material;this._materialLayoutVersion!==t.layoutVersion&&this._rebuildParameterLists();let s=this._materialOverrides,r=this._materialTextureOverrides,i=t.uniformBuffer;if(s.length===0&&r.length===0||!i)return null;let a=i.format,o=t.uniformBufferBindGroup.format,n=this._materialUniformBuffer;if(!n||n.format!==a||this._materialBindGroup.format!==o){this._destroyMaterialUniformBuffer(),n=new Nt(e,a,!0),this._materialUniformBuffer=n,this._materialBindGroup=new bt(e,o,n),this._syncedMaterialDataVersion=-1;for(let d=0;d<s.length;d++)s[d].uniformFormat=null}if(this._syncedMaterialDataVersion!==t.uniformDataVersion||this._syncedOverridesVersion!==this._materialOverridesVersion){n.storageFloat32.set(i.storageFloat32);for(let d=0;d<s.length;d++){let f=s[d];f.uniformFormat??(f.uniformFormat=a.get(f.name)),n.setUniform(f.uniformFormat,f.data)}n.upload(),this._syncedMaterialDataVersion=t.uniformDataVersion,this._syncedOverridesVersion=this._materialOverridesVersion}let c=this._materialBindGroup,h=t.uniformBufferBindGroup.textures;for(let d=0;d<h.length;d++){let f=h[d];f&&c.setTextureAt(d,f)}for(let d=0;d<r.length;d++){let f=r[d];c.setTextureAt(f.textureSlot,f.data)}return c.commit(),c}_destroyMaterialUniformBuffer(){this._materialBindGroup?.destroy(),this._materialBindGroup=null,this._materialUniformBuffer?.destroy(),this._materialUniformBuffer=null}setLightmapped(e){e?this.mask=(this.mask|La)&~(Tt|rm):(this.setRealtimeLightmap(l.lightmapParamNames[0],null),this.setRealtimeLightmap(l.lightmapParamNames[1],null),this._shaderDefs&=~(jc|qc|$c),this.mask=(this.mask|Tt)&~(La|rm))}setCustomAabb(e){e?this._customAabb?this._customAabb.copy(e):this._customAabb=e.clone():(this._customAabb=null,this._aabbVer=-1),this._setupSkinUpdate()}_setupSkinUpdate(){this._skinInstance&&(this._skinInstance._updateBeforeCull=!this._customAabb)}};var hS="uSceneColorMap",hh=class extends Dt{colorRenderTarget=null;source=null;destroy(){super.destroy(),this.releaseRenderTarget(this.colorRenderTarget)}shouldReallocate(e,t,s){if(e?.colorBuffer.format!==s)return!0;let i=t?.width||this.device.width,a=t?.height||this.device.height;return!e||i!==e.width||a!==e.height}allocateRenderTarget(e,t,s,r){let i=new se(s,{name:hS,format:r,width:t?t.colorBuffer.width:s.width,height:t?t.colorBuffer.height:s.height,mipmaps:!0,minFilter:5,magFilter:1,addressU:1,addressV:1});return e?(e.destroyFrameBuffers(),e._colorBuffer=i,e._colorBuffers=[i],e.evaluateDimensions()):e=new Le({name:"ColorGrabRT",colorBuffer:i,depth:!1,stencil:!1,autoResolve:!1}),e}releaseRenderTarget(e){e&&(e.destroyTextureBuffers(),e.destroy())}frameUpdate(){let e=this.device,t=this.source,s=t?.colorBuffer.format??this.device.backBufferFormat;this.shouldReallocate(this.colorRenderTarget,t?.colorBuffer,s)&&(this.releaseRenderTarget(this.colorRenderTarget),this.colorRenderTarget=this.allocateRenderTarget(this.colorRenderTarget,t,e,s));let r=this.colorRenderTarget.colorBuffer;e.scope.resolve(hS).setValue(r)}execute(){let e=this.device,t=this.source,s=this.colorRenderTarget.colorBuffer;e.isWebGPU?(e.copyRenderTarget(t,this.colorRenderTarget,!0,!1),e.mipmapRenderer.generate(this.colorRenderTarget.colorBuffer.impl)):(e.copyRenderTarget(t,this.colorRenderTarget,!0,!1),e.activeTexture(e.maxCombinedTextures-1),e.bindTexture(s),e.gl.generateMipmap(s.impl._glTarget))}};var dS="uSceneDepthMap",dh=class extends Dt{depthRenderTarget=null;camera=null;constructor(e,t){super(e),this.camera=t}destroy(){super.destroy(),this.releaseRenderTarget(this.depthRenderTarget)}shouldReallocate(e,t){let s=t?.width||this.device.width,r=t?.height||this.device.height;return!e||s!==e.width||r!==e.height}allocateRenderTarget(e,t,s,r,i){let a=se.createDataTexture2D(s,dS,t?t.colorBuffer.width:s.width,t?t.colorBuffer.height:s.height,r);return e?(e.destroyFrameBuffers(),i?e._depthBuffer=a:(e._colorBuffer=a,e._colorBuffers=[a]),e.evaluateDimensions()):e=new Le({name:"DepthGrabRT",colorBuffer:i?null:a,depthBuffer:i?a:null,depth:!i,stencil:s.supportsStencil,autoResolve:!1}),e}releaseRenderTarget(e){e&&(e.destroyTextureBuffers(),e.destroy())}before(){let e=this.camera,t=this.device,s=e?.renderTarget??t.backBuffer,r=!0,i=s.stencil?oi:Lt;t.isWebGPU&&s.samples>1&&(i=lt,r=!1);let a=e.renderTarget?.depthBuffer??e.renderTarget?.colorBuffer;this.shouldReallocate(this.depthRenderTarget,a)&&(this.releaseRenderTarget(this.depthRenderTarget),this.depthRenderTarget=this.allocateRenderTarget(this.depthRenderTarget,e.renderTarget,t,i,r));let o=r?this.depthRenderTarget.depthBuffer:this.depthRenderTarget.colorBuffer;t.scope.resolve(dS).setValue(o),e.publishSceneDepthMap(o,t.renderVersion)}execute(){let e=this.device;if(e.isWebGL2&&e.renderTarget.samples>1){let t=e.renderTarget.impl._glFrameBuffer,s=this.depthRenderTarget;e.renderTarget=s,e.updateBegin(),this.depthRenderTarget.impl.internalResolve(e,t,s.impl._glFrameBuffer,this.depthRenderTarget,e.gl.DEPTH_BUFFER_BIT)}else e.copyRenderTarget(e.renderTarget,this.depthRenderTarget,!1,!0)}};var fh=class{_gammaCorrection=Wr;_toneMapping=Eg;_srgbRenderTarget=!1;_ssaoEnabled=!1;_fog=Is;_sceneDepthMapLinear=!1;_sceneDepthMapPacked=!1;_sceneDepthMapReciprocal=!1;_sceneTextures=[];_hash;_defines=new Map;_definesDirty=!0;get hash(){if(this._hash===void 0){let e=`${this.gammaCorrection}_${this.toneMapping}_${this.srgbRenderTarget}_${this.fog}_${this.ssaoEnabled}_${this.sceneDepthMapLinear}_${this.sceneDepthMapPacked}_${this.sceneDepthMapReciprocal}_${this._sceneTextures.join("-")}`;this._hash=$e(e)}return this._hash}get defines(){let e=this._defines;return this._definesDirty&&(this._definesDirty=!1,e.clear(),this._sceneDepthMapLinear&&(e.set("SCENE_DEPTHMAP_LINEAR",""),this._sceneDepthMapPacked&&e.set("SCENE_DEPTHMAP_PACKED",""),this._sceneDepthMapReciprocal&&e.set("SCENE_DEPTHMAP_RECIPROCAL","")),this._sceneTextures.forEach((t,s)=>{let r=t.toUpperCase();e.set(`SCENE_TEXTURE_${r}`,""),e.set(`{SCENE_TEXTURE_${r}_SLOT}`,String(s+1))}),this.shaderOutputGamma===Wr&&e.set("SCENE_COLORMAP_GAMMA",""),e.set("FOG",this._fog.toUpperCase()),e.set("TONEMAP",Xc[this._toneMapping]),e.set("GAMMA",Tg[this.shaderOutputGamma])),e}markDirty(){this._hash=void 0,this._definesDirty=!0}set fog(e){this._fog!==e&&(this._fog=e,this.markDirty())}get fog(){return this._fog}set ssaoEnabled(e){this._ssaoEnabled!==e&&(this._ssaoEnabled=e,this.markDirty())}get ssaoEnabled(){return this._ssaoEnabled}set gammaCorrection(e){this._gammaCorrectionAssigned=!0,this._gammaCorrection!==e&&(this._gammaCorrection=e,this.markDirty())}get gammaCorrection(){return this._gammaCorrection}set toneMapping(e){this._toneMapping!==e&&(this._toneMapping=e,this.markDirty())}get toneMapping(){return this._toneMapping}set srgbRenderTarget(e){this._srgbRenderTarget!==e&&(this._srgbRenderTarget=e,this.markDirty())}get srgbRenderTarget(){return this._srgbRenderTarget}set sceneDepthMapLinear(e){this._sceneDepthMapLinear!==e&&(this._sceneDepthMapLinear=e,this.markDirty())}get sceneDepthMapLinear(){return this._sceneDepthMapLinear}set sceneDepthMapPacked(e){this._sceneDepthMapPacked!==e&&(this._sceneDepthMapPacked=e,this.markDirty())}get sceneDepthMapPacked(){return this._sceneDepthMapPacked}set sceneDepthMapReciprocal(e){this._sceneDepthMapReciprocal!==e&&(this._sceneDepthMapReciprocal=e,this.markDirty())}get sceneDepthMapReciprocal(){return this._sceneDepthMapReciprocal}set sceneTextures(e){let t=e??[];oS.equals(this._sceneTextures,t)||(this._sceneTextures=t.slice(),this.markDirty())}get sceneTextures(){return this._sceneTextures}get shaderOutputGamma(){return this._gammaCorrection===Wr&&!this._srgbRenderTarget?Wr:Jo}};var Ha=new y,_n=new y,fS=new y,uS=new N,uh=new N,mS=new ai,xm=new N,pS=new N,_S=new N,L0=[new y,new y,new y,new y,new y,new y,new y,new y],b0=0,Vt=class l{static _flipYProjectionMatrix=new N().setScale(1,-1,1);static _webGpuDepthRangeMatrix=new N().set([1,0,0,0,0,1,0,0,0,0,.5,0,0,0,.5,1]);static _applyShaderProjectionScratch=new N;static applyShaderProjectionTransform(e,t,s,r){if(!s&&!r)return t.copy(e),t;if(s&&r){let i=l._applyShaderProjectionScratch;return i.mul2(l._flipYProjectionMatrix,e),t.mul2(l._webGpuDepthRangeMatrix,i),t}return s?(t.mul2(l._flipYProjectionMatrix,e),t):(t.mul2(l._webGpuDepthRangeMatrix,e),t)}shaderPassInfo=null;renderPassColorGrab=null;renderPassDepthGrab=null;fogParams=null;shaderParams=new fh;framePasses=[];beforePasses=[];sceneDepthMap=null;sceneDepthMapVersion=-1;jitter=0;id=b0++;device;constructor(e){this.device=e,this._aspectRatio=16/9,this._aspectRatioMode=nm,this._calculateProjection=null,this._calculateTransform=null,this._clearColor=new z(.75,.75,.75,1),this._clearColors=null,this._clearColorBuffer=!0,this._clearDepth=1,this._clearDepthBuffer=!0,this._clearStencil=0,this._clearStencilBuffer=!0,this._cullFaces=!0,this._farClip=1e3,this._flipFaces=!1,this._fov=45,this._frustumCulling=!0,this._horizontalFov=!1,this._layers=[xa,it,Aa,Pa,Ra],this._layersSet=new Set(this._layers),this._nearClip=.1,this._node=null,this._orthoHeight=10,this._projection=ws,this._projectionOffset=new k,this._rect=new ne(0,0,1,1),this._renderTarget=null,this._scissorRect=new ne(0,0,1,1),this._scissorRectClear=!1,this._aperture=16,this._shutter=1/1e3,this._sensitivity=1e3,this._projMat=new N,this._projMatDirty=!0,this._projMatSkybox=new N,this._viewMat=new N,this._viewMatDirty=!0,this._viewProjMat=new N,this._viewProjMatDirty=!0,this._shaderMatricesVersion=0,this._viewProjInverse=new N,this._viewProjCurrent=null,this._viewProjPrevious=new N,this._jitters=[0,0,0,0],this.frustum=new ai,this._cullLayers=new Set,this._xrViews=null,this._xrProperties={horizontalFov:this._horizontalFov,fov:this._fov,aspectRatio:this._aspectRatio,farClip:this._farClip,nearClip:this._nearClip}}destroy(){this.renderPassColorGrab?.destroy(),this.renderPassColorGrab=null,this.renderPassDepthGrab?.destroy(),this.renderPassDepthGrab=null,this.framePasses.length=0,this.beforePasses.length=0,this.sceneDepthMap=null}publishSceneDepthMap(e,t){this.sceneDepthMap=e,this.sceneDepthMapVersion=t}_storeShaderMatrices(e,t,s,r){this._shaderMatricesVersion!==r&&(this._shaderMatricesVersion=r,this._viewProjPrevious.copy(this._viewProjCurrent??e),this._viewProjCurrent??(this._viewProjCurrent=new N),this._viewProjCurrent.copy(e),this._viewProjInverse.invert(e),this._jitters[2]=this._jitters[0],this._jitters[3]=this._jitters[1],this._jitters[0]=t,this._jitters[1]=s)}get fullSizeClearRect(){let e=this._scissorRectClear?this.scissorRect:this._rect;return e.x===0&&e.y===0&&e.z===1&&e.w===1}set aspectRatio(e){this._aspectRatio!==e&&(this._aspectRatio=e,this._projMatDirty=!0)}get aspectRatio(){if(this.xrActive)return this._xrProperties.aspectRatio;if(this._aspectRatioMode===nm){let e=this.calculateAspectRatio();this._aspectRatio!==e&&(this._aspectRatio=e,this._projMatDirty=!0)}return this._aspectRatio}set aspectRatioMode(e){this._aspectRatioMode!==e&&(this._aspectRatioMode=e,this._projMatDirty=!0)}get aspectRatioMode(){return this._aspectRatioMode}set calculateProjection(e){this._calculateProjection=e,this._projMatDirty=!0}get calculateProjection(){return this._calculateProjection}set calculateTransform(e){this._calculateTransform=e}get calculateTransform(){return this._calculateTransform}set clearColor(e){this._clearColor.copy(e)}get clearColor(){return this._clearColor}setClearColor(e,t){var s;e===0?this._clearColor.copy(t):t?(this._clearColors??(this._clearColors=[]),((s=this._clearColors)[e]??(s[e]=new z)).copy(t)):this._clearColors&&(this._clearColors[e]=void 0)}getClearColor(e){return this._clearColors?.[e]??this._clearColor}set clearColorBuffer(e){this._clearColorBuffer=e}get clearColorBuffer(){return this._clearColorBuffer}set clearDepth(e){this._clearDepth=e}get clearDepth(){return this._clearDepth}set clearDepthBuffer(e){this._clearDepthBuffer=e}get clearDepthBuffer(){return this._clearDepthBuffer}set clearStencil(e){this._clearStencil=e}get clearStencil(){return this._clearStencil}set clearStencilBuffer(e){this._clearStencilBuffer=e}get clearStencilBuffer(){return this._clearStencilBuffer}set cullFaces(e){this._cullFaces=e}get cullFaces(){return this._cullFaces}set farClip(e){this._farClip!==e&&(this._farClip=e,this._projMatDirty=!0)}get farClip(){return this.xrActive?this._xrProperties.farClip:this._farClip}set flipFaces(e){this._flipFaces=e}get flipFaces(){return this._flipFaces}set fov(e){this._fov!==e&&(this._fov=e,this._projMatDirty=!0)}get fov(){return this.xrActive?this._xrProperties.fov:this._fov}set frustumCulling(e){this._frustumCulling=e}get frustumCulling(){return this._frustumCulling}set horizontalFov(e){this._horizontalFov!==e&&(this._horizontalFov=e,this._projMatDirty=!0)}get horizontalFov(){return this.xrActive?this._xrProperties.horizontalFov:this._horizontalFov}set layers(e){this._layers=e.slice(0),this._layersSet=new Set(this._layers)}get layers(){return this._layers}get layersSet(){return this._layersSet}set nearClip(e){this._nearClip!==e&&(this._nearClip=e,this._projMatDirty=!0)}get nearClip(){return this.xrActive?this._xrProperties.nearClip:this._nearClip}set node(e){this._node=e}get node(){return this._node}set orthoHeight(e){this._orthoHeight!==e&&(this._orthoHeight=e,this._projMatDirty=!0)}get orthoHeight(){return this._orthoHeight}set projection(e){this._projection!==e&&(this._projection=e,this._projMatDirty=!0)}get projection(){return this._projection}get projectionMatrix(){return this._evaluateProjectionMatrix(),this._projMat}set projectionOffset(e){this._projectionOffset.copy(e),this._projMatDirty=!0}get projectionOffset(){return this._projectionOffset}set rect(e){this._rect.copy(e),this._projMatDirty=!0}get rect(){return this._rect}set renderTarget(e){this._renderTarget=e,this._projMatDirty=!0}get renderTarget(){return this._renderTarget}set scissorRect(e){this._scissorRect.copy(e)}get scissorRect(){return this._scissorRect}get viewMatrix(){if(this._viewMatDirty){let e=this._node.getWorldTransform();this._viewMat.copy(e).invert(),this._viewMatDirty=!1}return this._viewMat}set aperture(e){this._aperture=e}get aperture(){return this._aperture}set sensitivity(e){this._sensitivity=e}get sensitivity(){return this._sensitivity}set shutter(e){this._shutter=e}get shutter(){return this._shutter}set xrViews(e){e!==null!=(this._xrViews!==null)&&(this._projMatDirty=!0),this._xrViews=e}get xrViews(){return this._xrViews}get xrActive(){return this._xrViews!==null}addCullLayer(e){let t=this._cullLayers.size===0;return this._cullLayers.add(e),t}get cullLayers(){return this._cullLayers}clearCullLayers(){this._cullLayers.clear()}calculateAspectRatio(e){let t=e??this._renderTarget,s=t?t.width:this.device.width,r=t?t.height:this.device.height;return s*this._rect.z/(r*this._rect.w)}clone(){return new l(this.device).copy(this)}copy(e){return this._aspectRatio=e._aspectRatio,this._farClip=e._farClip,this._fov=e._fov,this._horizontalFov=e._horizontalFov,this._nearClip=e._nearClip,this._xrProperties.aspectRatio=e._xrProperties.aspectRatio,this._xrProperties.farClip=e._xrProperties.farClip,this._xrProperties.fov=e._xrProperties.fov,this._xrProperties.horizontalFov=e._xrProperties.horizontalFov,this._xrProperties.nearClip=e._xrProperties.nearClip,this.aspectRatioMode=e.aspectRatioMode,this.calculateProjection=e.calculateProjection,this.calculateTransform=e.calculateTransform,this.clearColor=e.clearColor,this._clearColors=null,e._clearColors?.forEach((t,s)=>this.setClearColor(s,t)),this.clearColorBuffer=e.clearColorBuffer,this.clearDepth=e.clearDepth,this.clearDepthBuffer=e.clearDepthBuffer,this.clearStencil=e.clearStencil,this.clearStencilBuffer=e.clearStencilBuffer,this.cullFaces=e.cullFaces,this.flipFaces=e.flipFaces,this.frustumCulling=e.frustumCulling,this.layers=e.layers,this.orthoHeight=e.orthoHeight,this.projection=e.projection,this.projectionOffset=e.projectionOffset,this.rect=e.rect,this.renderTarget=e.renderTarget,this.scissorRect=e.scissorRect,this.aperture=e.aperture,this.shutter=e.shutter,this.sensitivity=e.sensitivity,this.shaderPassInfo=e.shaderPassInfo,this.jitter=e.jitter,this._projMatDirty=!0,this}_enableRenderPassColorGrab(e,t){t?this.renderPassColorGrab||(this.renderPassColorGrab=new hh(e)):(this.renderPassColorGrab?.destroy(),this.renderPassColorGrab=null)}_enableRenderPassDepthGrab(e,t,s){s?this.renderPassDepthGrab||(this.renderPassDepthGrab=new dh(e,this)):(this.renderPassDepthGrab?.destroy(),this.renderPassDepthGrab=null)}_updateViewProjMat(){(this._projMatDirty||this._viewMatDirty||this._viewProjMatDirty)&&(this._viewProjMat.mul2(this.projectionMatrix,this.viewMatrix),this._viewProjMatDirty=!1)}updateViewTransforms(){let e=this.xrViews;if(!e)return;let t=this._node?.parent?.getWorldTransform()??null;for(let s=0;s<e.length;s++)e[s].updateTransforms(t)}updateXrFrustum(){let e=this.xrViews;if(!e?.length)return!1;this.updateViewTransforms(),uh.mul2(e[0].projMat,e[0].viewOffMat),this.frustum.setFromMat4(uh);for(let t=1;t<e.length;t++)uh.mul2(e[t].projMat,e[t].viewOffMat),mS.setFromMat4(uh),this.frustum.add(mS);return!0}updateFrustum(){if(this.updateXrFrustum())return;let e=this.projectionMatrix;if(this.calculateProjection&&this.calculateProjection(e,ba),this.calculateTransform)this.calculateTransform(xm,ba);else{let t=this._node.getPosition(),s=this._node.getRotation();xm.setTRS(t,s,y.ONE)}pS.copy(xm).invert(),_S.mul2(e,pS),this.frustum.setFromMat4(_S)}worldToScreen(e,t,s,r=new y){this._updateViewProjMat(),this._viewProjMat.transformPoint(e,r);let i=this._viewProjMat.data,a=e.x*i[3]+e.y*i[7]+e.z*i[11]+1*i[15];r.x=(r.x/a+1)*.5,r.y=(1-r.y/a)*.5;let{x:o,y:n,z:c,w:h}=this._rect;return r.x=r.x*c*t+o*t,r.y=r.y*h*s+(1-n-h)*s,r}screenToWorld(e,t,s,r,i,a=new y){let{x:o,y:n,z:c,w:h}=this._rect,d=this.farClip-this.nearClip;if(Ha.set((e-o*r)/(c*r),1-(t-(1-n-h)*i)/(h*i),s/d),Ha.mulScalar(2),Ha.sub(y.ONE),this._projection===ws){N._getPerspectiveHalfSize(_n,this.fov,this.aspectRatio,this.nearClip,this.horizontalFov);let f=this.xrActive?k.ZERO:this._projectionOffset;_n.x*=Ha.x+f.x,_n.y*=Ha.y+f.y;let u=this._node.getWorldTransform();_n.z=-this.nearClip,u.transformPoint(_n,fS);let m=this._node.getPosition();a.sub2(fS,m),a.normalize(),a.mulScalar(s),a.add(m)}else this._updateViewProjMat(),uS.copy(this._viewProjMat).invert(),uS.transformPoint(Ha,a);return a}_evaluateProjectionMatrix(){let e=this.aspectRatio;if(this._projMatDirty){let t=this._projectionOffset;if(this._projection===ws)this._projMat.setPerspective(this.fov,e,this.nearClip,this.farClip,this.horizontalFov),this._projMat.data[8]=t.x,this._projMat.data[9]=t.y,this._projMatSkybox.copy(this._projMat);else{let s=this._orthoHeight,r=s*e;this._projMat.setOrtho(-r,r,-s,s,this.nearClip,this.farClip),this._projMat.data[12]=-t.x,this._projMat.data[13]=-t.y,this._projMatSkybox.setPerspective(this.fov,e,this.nearClip,this.farClip),this._projMatSkybox.data[8]=t.x,this._projMatSkybox.data[9]=t.y}this._projMatDirty=!1}}getProjectionMatrixSkybox(){return this._evaluateProjectionMatrix(),this._projMatSkybox}getExposure(){let e=Math.log2(this._aperture*this._aperture/this._shutter*100/this._sensitivity);return 1/(Math.pow(2,e)*1.2)}getScreenSize(e){if(this._projection===ws){let t=this._node.getPosition().distance(e.center);if(t<e.radius)return 1;let s=Math.asin(e.radius/t),r=Math.tan(s),i=Math.tan(this.fov/2*O.DEG_TO_RAD);return Math.min(r/i,1)}return O.clamp(e.radius/this._orthoHeight,0,1)}getFrustumCorners(e=this.nearClip,t=this.farClip){let s=this.fov*O.DEG_TO_RAD,r=this.xrActive?k.ZERO:this._projectionOffset,i,a;this.projection===ws?this.horizontalFov?(i=e*Math.tan(s/2),a=i/this.aspectRatio):(a=e*Math.tan(s/2),i=a*this.aspectRatio):(a=this._orthoHeight,i=a*this.aspectRatio);let o=r.x*i,n=r.y*a,c=L0;return c[0].x=o+i,c[0].y=n-a,c[0].z=-e,c[1].x=o+i,c[1].y=n+a,c[1].z=-e,c[2].x=o-i,c[2].y=n+a,c[2].z=-e,c[3].x=o-i,c[3].y=n-a,c[3].z=-e,this._projection===ws&&(this.horizontalFov?(i=t*Math.tan(s/2),a=i/this.aspectRatio):(a=t*Math.tan(s/2),i=a*this.aspectRatio),o=r.x*i,n=r.y*a),c[4].x=o+i,c[4].y=n-a,c[4].z=-t,c[5].x=o+i,c[5].y=n+a,c[5].z=-t,c[6].x=o-i,c[6].y=n+a,c[6].z=-t,c[7].x=o-i,c[7].y=n-a,c[7].z=-t,c}setXrProperties(e){Object.assign(this._xrProperties,e),this._projMatDirty=!0}fillShaderParams(e){let t=this._farClip;return e[0]=1/t,e[1]=t,e[2]=this._nearClip,e[3]=this._projection===Bt?1:0,e}};var gS=new N,SS=new N,TS=new N,bs=class l{static pointLightRotations=[new fe().setFromEulerAngles(0,90,180),new fe().setFromEulerAngles(0,-90,180),new fe().setFromEulerAngles(90,0,0),new fe().setFromEulerAngles(-90,0,0),new fe().setFromEulerAngles(0,180,180),new fe().setFromEulerAngles(0,0,180)];static create(e,t,s,r){let i=new Vt(e);switch(i.node=new wt(t),i.aspectRatio=1,i.aspectRatioMode=Lg,i._scissorRectClear=!0,s){case ze:i.node.setRotation(l.pointLightRotations[r]),i.fov=90,i.projection=ws;break;case Ue:i.projection=ws;break;case te:i.projection=Bt;break}return i}static _spotCookieCamera=null;static evalSpotCookieMatrix(e){let t=l._spotCookieCamera;t||(t=l.create(e.device,"SpotCookieCamera",Ue),l._spotCookieCamera=t),t.fov=e._outerConeAngle*2;let s=t._node;s.setPosition(e._node.getPosition()),s.setRotation(e._node.getRotation()),s.rotateLocal(-90,0,0),gS.setTRS(s.getPosition(),s.getRotation(),y.ONE).invert(),SS.mul2(t.projectionMatrix,gS);let r=e.cookieMatrix,i=e.atlasViewport;return TS.setViewport(i.x,i.y,i.z,i.w),r.mul2(TS,SS),r}};var ss=new y,wi=new Float32Array(6),F0=new y(-.5,0,0),O0=new y(0,0,.5),ke={POSITION_RANGE:0,DIRECTION_FLAGS:1,COLOR_ANGLES_BIAS:2,PROJ_MAT_0:3,ATLAS_VIEWPORT:3,PROJ_MAT_1:4,PROJ_MAT_2:5,PROJ_MAT_3:6,AREA_DATA_WIDTH:7,AREA_DATA_HEIGHT:8,COUNT:9},N0={LIGHTSHAPE_PUNCTUAL:`${Qt}u`,LIGHTSHAPE_RECT:`${Ku}u`,LIGHTSHAPE_DISK:`${Zu}u`,LIGHTSHAPE_SPHERE:`${Qu}u`,LIGHT_COLOR_DIVIDER:`${ug}.0`},ES=(l,e)=>Object.keys(l).map(t=>`#define {${e}${t}} ${l[t]}`).join(`
`),yS=`

		${ES(ke,"CLUSTER_TEXTURE_")}
		${ES(N0,"")}
`,mh=class{areaLightsEnabled=!1;lightsTexture=null;_maxLights=0;constructor(e){this.device=e,Ee.get(e,ce).set("lightBufferDefinesPS",yS),Ee.get(e,q).set("lightBufferDefinesPS",yS),this.cookiesEnabled=!1,this.shadowsEnabled=!1,this.areaLightsEnabled=!1,this._lightsTextureId=this.device.scope.resolve("lightsTexture"),this.maxLights=256,this.invMaxColorValue=0,this.invMaxAttenuation=0,this.boundsMin=new y,this.boundsDelta=new y}set maxLights(e){if(this._maxLights!==e){this._maxLights=e;let t=ke.COUNT;this.lightsFloat=new Float32Array(4*t*e),this.lightsUint=new Uint32Array(this.lightsFloat.buffer),this.lightsTexture?.destroy(),this.lightsTexture=this.createTexture(this.device,t,e,We,"LightsTexture")}}get maxLights(){return this._maxLights}destroy(){this.lightsTexture?.destroy(),this.lightsTexture=null}createTexture(e,t,s,r,i){return new se(e,{name:i,width:t,height:s,mipmaps:!1,format:r,addressU:1,addressV:1,type:At,magFilter:0,minFilter:0,anisotropy:1})}setBounds(e,t){this.boundsMin.copy(e),this.boundsDelta.copy(t)}uploadTextures(){this.lightsTexture.lock().set(this.lightsFloat),this.lightsTexture.unlock()}updateUniforms(){this._lightsTextureId.setValue(this.lightsTexture)}getSpotDirection(e,t){t._node.getWorldTransform().getY(e).mulScalar(-1),e.normalize()}getLightAreaSizes(e){let t=e._node.getWorldTransform();return t.transformVector(F0,ss),wi[0]=ss.x,wi[1]=ss.y,wi[2]=ss.z,t.transformVector(O0,ss),wi[3]=ss.x,wi[4]=ss.y,wi[5]=ss.z,wi}addLightData(e,t){let s=e._type===Ue,r=e.atlasViewportAllocated,i=this.cookiesEnabled&&!!e._cookie&&r,a=this.areaLightsEnabled&&e.shape!==Qt,o=this.shadowsEnabled&&e.castShadows&&r,n=e._node.getPosition(),c=null,h=null;s?o?c=e.getRenderData(null,0).shadowMatrix:i&&(c=bs.evalSpotCookieMatrix(e)):(o||i)&&(h=e.atlasViewport);let d=this.lightsFloat,f=this.lightsUint,u=t*this.lightsTexture.width*4;d[u+4*ke.POSITION_RANGE+0]=n.x,d[u+4*ke.POSITION_RANGE+1]=n.y,d[u+4*ke.POSITION_RANGE+2]=n.z,d[u+4*ke.POSITION_RANGE+3]=e.attenuationEnd;let m=e.clusteredData;if(f[u+4*ke.COLOR_ANGLES_BIAS+0]=m[0],f[u+4*ke.COLOR_ANGLES_BIAS+1]=m[1],f[u+4*ke.COLOR_ANGLES_BIAS+2]=m[2],e.castShadows){let _=e.getRenderData(null,0),p=e._getUniformBiasValues(_),g=gs.float2Half(p.bias),T=gs.float2Half(p.normalBias);f[u+4*ke.COLOR_ANGLES_BIAS+3]=g|T<<16}if(s&&(this.getSpotDirection(ss,e),d[u+4*ke.DIRECTION_FLAGS+0]=ss.x,d[u+4*ke.DIRECTION_FLAGS+1]=ss.y,d[u+4*ke.DIRECTION_FLAGS+2]=ss.z),f[u+4*ke.DIRECTION_FLAGS+3]=e.getClusteredFlags(o,i),c){let _=c.data;for(let p=0;p<16;p++)d[u+4*ke.PROJ_MAT_0+p]=_[p]}if(h&&(d[u+4*ke.ATLAS_VIEWPORT+0]=h.x,d[u+4*ke.ATLAS_VIEWPORT+1]=h.y,d[u+4*ke.ATLAS_VIEWPORT+2]=h.z/3),a){let _=this.getLightAreaSizes(e);d[u+4*ke.AREA_DATA_WIDTH+0]=_[0],d[u+4*ke.AREA_DATA_WIDTH+1]=_[1],d[u+4*ke.AREA_DATA_WIDTH+2]=_[2],d[u+4*ke.AREA_DATA_HEIGHT+0]=_[3],d[u+4*ke.AREA_DATA_HEIGHT+1]=_[4],d[u+4*ke.AREA_DATA_HEIGHT+2]=_[5]}}};var B0=new k,ph=new y,_h=new y,gh=new y,Am=new J;var Sh=class{constructor(){this.light=null,this.min=new y,this.max=new y}},gn=class{clusterTexture;constructor(e){this.device=e,this.name="Untitled",this.reportCount=0,this.boundsMin=new y,this.boundsMax=new y,this.boundsDelta=new y,this._cells=new y(1,1,1),this._cellsLimit=new y,this.cells=this._cells,this.maxCellLightCount=4,this._usedLights=[],this._usedLights.push(new Sh),this.lightsBuffer=new mh(e),this.registerUniforms(e)}get usedLights(){return this._usedLights}set maxCellLightCount(e){e!==this._maxCellLightCount&&(this._maxCellLightCount=e,this._cellsDirty=!0)}get maxCellLightCount(){return this._maxCellLightCount}set maxLights(e){e!==this.maxLights&&(this.lightsBuffer.maxLights=e+1,this._cellsDirty=!0)}get maxLights(){return this.lightsBuffer.maxLights-1}set cells(e){ph.copy(e).floor(),this._cells.equals(ph)||(this._cells.copy(ph),this._cellsLimit.copy(ph).sub(y.ONE),this._cellsDirty=!0)}get cells(){return this._cells}destroy(){this.lightsBuffer.destroy(),this.releaseClusterTexture()}releaseClusterTexture(){this.clusterTexture&&(this.clusterTexture.destroy(),this.clusterTexture=null)}registerUniforms(e){this._numClusteredLightsId=e.scope.resolve("numClusteredLights"),this._clusterMaxCellsId=e.scope.resolve("clusterMaxCells"),this._clusterWorldTextureId=e.scope.resolve("clusterWorldTexture"),this._clusterBoundsMinId=e.scope.resolve("clusterBoundsMin"),this._clusterBoundsMinData=new Float32Array(3),this._clusterBoundsDeltaId=e.scope.resolve("clusterBoundsDelta"),this._clusterBoundsDeltaData=new Float32Array(3),this._clusterCellsCountByBoundsSizeId=e.scope.resolve("clusterCellsCountByBoundsSize"),this._clusterCellsCountByBoundsSizeData=new Float32Array(3),this._clusterCellsDotId=e.scope.resolve("clusterCellsDot"),this._clusterCellsDotData=new Int32Array(3),this._clusterCellsMaxId=e.scope.resolve("clusterCellsMax"),this._clusterCellsMaxData=new Int32Array(3),this._clusterTextureWidthId=e.scope.resolve("clusterTextureWidth")}updateParams(e){e&&(this.cells=e.cells,this.maxCellLightCount=e.maxLightsPerCell,this.maxLights=e.maxLights,this.lightsBuffer.cookiesEnabled=e.cookiesEnabled,this.lightsBuffer.shadowsEnabled=e.shadowsEnabled,this.lightsBuffer.areaLightsEnabled=e.areaLightsEnabled)}updateCells(){if(this._cellsDirty){this._cellsDirty=!1;let e=this._cells.x,t=this._cells.y,s=this._cells.z,r=e*t*s,i=this.maxCellLightCount*r,{x:a,y:o}=et.calcTextureSize(i,B0,this.maxCellLightCount);this._clusterCellsMaxData[0]=e,this._clusterCellsMaxData[1]=t,this._clusterCellsMaxData[2]=s,this._clusterCellsDotData[0]=this.maxCellLightCount,this._clusterCellsDotData[1]=e*s*this.maxCellLightCount,this._clusterCellsDotData[2]=e*this.maxCellLightCount;let n=this.maxLights>255;this.clusters=n?new Uint16Array(i):new Uint8ClampedArray(i),this.counts=new Int32Array(r),this.releaseClusterTexture(),this.clusterTexture=this.lightsBuffer.createTexture(this.device,a,o,n?zi:Ro,"ClusterTexture")}}uploadTextures(){this.clusterTexture.lock().set(this.clusters),this.clusterTexture.unlock(),this.lightsBuffer.uploadTextures()}updateUniforms(){this._numClusteredLightsId.setValue(this._usedLights.length),this.lightsBuffer.updateUniforms(),this._clusterWorldTextureId.setValue(this.clusterTexture),this._clusterMaxCellsId.setValue(this.maxCellLightCount);let e=this.boundsDelta;this._clusterCellsCountByBoundsSizeData[0]=this._cells.x/e.x,this._clusterCellsCountByBoundsSizeData[1]=this._cells.y/e.y,this._clusterCellsCountByBoundsSizeData[2]=this._cells.z/e.z,this._clusterCellsCountByBoundsSizeId.setValue(this._clusterCellsCountByBoundsSizeData),this._clusterBoundsMinData[0]=this.boundsMin.x,this._clusterBoundsMinData[1]=this.boundsMin.y,this._clusterBoundsMinData[2]=this.boundsMin.z,this._clusterBoundsDeltaData[0]=e.x,this._clusterBoundsDeltaData[1]=e.y,this._clusterBoundsDeltaData[2]=e.z,this._clusterBoundsMinId.setValue(this._clusterBoundsMinData),this._clusterBoundsDeltaId.setValue(this._clusterBoundsDeltaData),this._clusterCellsDotId.setValue(this._clusterCellsDotData),this._clusterCellsMaxId.setValue(this._clusterCellsMaxData),this._clusterTextureWidthId.setValue(this.clusterTexture.width)}evalLightCellMinMax(e,t,s){t.copy(e.min),t.sub(this.boundsMin),t.div(this.boundsDelta),t.mul2(t,this.cells),t.floor(),s.copy(e.max),s.sub(this.boundsMin),s.div(this.boundsDelta),s.mul2(s,this.cells),s.ceil(),t.max(y.ZERO),s.min(this._cellsLimit)}collectLights(e){let t=this.lightsBuffer.maxLights,s=this._usedLights,r=1;e.forEach(i=>{let a=!!(i.mask&(Tt|La)),o=i.type===Ue&&i._outerConeAngle===0;if(i.enabled&&i.type!==te&&i.visibleThisFrame&&i.intensity>0&&a&&!o&&r<t){let n;r<s.length?n=s[r]:(n=new Sh,s.push(n)),n.light=i,i.getBoundingBox(Am),n.min.copy(Am.getMin()),n.max.copy(Am.getMax()),r++}}),s.length=r}evaluateBounds(){let e=this._usedLights,t=this.boundsMin,s=this.boundsMax;if(e.length>1){t.copy(e[1].min),s.copy(e[1].max);for(let r=2;r<e.length;r++)t.min(e[r].min),s.max(e[r].max)}else t.set(0,0,0),s.set(1,1,1);this.boundsDelta.sub2(s,t),this.lightsBuffer.setBounds(t,this.boundsDelta)}updateClusters(e){this.counts.fill(0),this.clusters.fill(0),this.lightsBuffer.areaLightsEnabled=e?e.areaLightsEnabled:!1;let t=this._cells.x,s=this._cells.z,r=this.counts,i=this._maxCellLightCount,a=this.clusters,o=this.maxCellLightCount,n=!1,c=this._usedLights;for(let h=1;h<c.length;h++){let d=c[h],f=d.light;this.lightsBuffer.addLightData(f,h),this.evalLightCellMinMax(d,_h,gh);let u=_h.x,m=gh.x,_=_h.y,p=gh.y,g=_h.z,T=gh.z;for(let S=u;S<=m;S++)for(let x=g;x<=T;x++)for(let C=_;C<=p;C++){let E=S+t*(x+C*s),v=r[E];v<i?(a[o*E+v]=h,r[E]=v+1):n=!0}}}update(e,t=null){this.updateParams(t),this.updateCells(),this.collectLights(e),this.evaluateBounds(),this.updateClusters(t),this.uploadTextures()}activate(){this.updateUniforms()}};var CS=l=>{let e=l.mask&Kc;return e===Kc?0:e&Tt?1:2},U0=(l,e)=>l._type-e._type||CS(l)-CS(e)||l.key-e.key,Th=[],Zr=class{slots=[];directional=[];key="";hash=0;clustered=!0;update(e,t){this.clustered=t;let s=this.slots,r=this.directional;s.length=0,r.length=0;for(let a=0;a<e.length;a++){let o=e[a];if(!o.enabled)continue;let n=o._type===te;n&&r.push(o),o.mask&Kc&&(n||!t)&&s.push(o)}s.sort(U0);let i="";for(let a=0;a<s.length;a++){let o=s[a].key;Th.push(o),i+=`${o},`}this.key=i,this.hash=Th.length>0?ua(Th):0,Th.length=0}};var vS=2.399963229728653,Eh={circlePoint(l){let e=Math.sqrt(Math.random()),t=Math.random()*2*Math.PI;l.x=e*Math.cos(t),l.y=e*Math.sin(t)},circlePointDeterministic(l,e,t){let s=e*vS,r=Math.sqrt(e/t);l.x=r*Math.cos(s),l.y=r*Math.sin(s)},spherePointDeterministic(l,e,t,s=0,r=1){s=1-2*s,r=1-2*r;let i=O.lerp(s,r,e/t),a=Math.sqrt(1-i*i),o=vS*e;l.x=Math.cos(o)*a,l.y=i,l.z=Math.sin(o)*a},radicalInverse(l){let e=(l<<16|l>>>16)>>>0;return e=((e&1431655765)<<1|(e&2863311530)>>>1)>>>0,e=((e&858993459)<<2|(e&3435973836)>>>2)>>>0,e=((e&252645135)<<4|(e&4042322160)>>>4)>>>0,e=((e&16711935)<<8|(e&4278255360)>>>8)>>>0,e*23283064365386963e-26}};var k0={linear:"decodeLinear",srgb:"decodeGamma",rgbm:"decodeRGBM",rgbe:"decodeRGBE",rgbp:"decodeRGBP",xy:"unpackNormalXY",xyz:"unpackNormalXYZ"},G0={linear:"encodeLinear",srgb:"encodeGamma",rgbm:"encodeRGBM",rgbe:"encodeRGBE",rgbp:"encodeRGBP"},zt=class{static decodeFunc(e){return k0[e]??"decodeGamma"}static encodeFunc(e){return G0[e]??"encodeGamma"}};var xS=l=>{switch(l){case Uo:return"Cubemap";case E_:return"Octahedral";default:return"Equirect"}},yh=(l,e,t)=>{if(l<=0)e[t+0]=0,e[t+1]=0,e[t+2]=0,e[t+3]=0;else if(l>=1)e[t+0]=255,e[t+1]=0,e[t+2]=0,e[t+3]=0;else{let s=1*l%1,r=255*l%1,i=65025*l%1,a=16581375*l%1;s-=r/255,r-=i/255,i-=a/255,e[t+0]=Math.min(255,Math.floor(s*256)),e[t+1]=Math.min(255,Math.floor(r*256)),e[t+2]=Math.min(255,Math.floor(i*256)),e[t+3]=Math.min(255,Math.floor(a*256))}},V0=l=>{let e=l.length,t=Math.min(e,512),s=Math.ceil(e/t),r=new Uint8Array(t*s*4),i=0;for(let a=0;a<e;a+=4)yh(l[a+0]*.5+.5,r,i+0),yh(l[a+1]*.5+.5,r,i+4),yh(l[a+2]*.5+.5,r,i+8),yh(l[a+3]/8,r,i+12),i+=16;return{width:t,height:s,data:r}},z0=(l,e,t,s)=>{let r=t*2*Math.PI,i=Math.pow(1-e,1/(s+1)),a=Math.sqrt(1-i*i);l.set(Math.cos(r)*a,Math.sin(r)*a,i).normalize()},H0=(l,e,t)=>{let s=t*2*Math.PI,r=Math.sqrt(1-e),i=Math.sqrt(e);l.set(Math.cos(s)*i,Math.sin(s)*i,r).normalize()},W0=(l,e,t,s)=>{let r=t*2*Math.PI,i=Math.sqrt((1-e)/(1+(s*s-1)*e)),a=Math.sqrt(1-i*i);l.set(Math.cos(r)*a,Math.sin(r)*a,i).normalize()},X0=(l,e)=>{let t=l*e,s=e/(1-l*l+t*t);return s*s*(1/Math.PI)},Y0=(l,e)=>{let t=new y,s=[];for(let r=0;r<l;++r)z0(t,r/l,Eh.radicalInverse(r),e),s.push(t.x,t.y,t.z,0);return s},j0=(l,e)=>{let t=e/l,s=new y,r=[];for(let i=0;i<l;++i){H0(s,i/l,Eh.radicalInverse(i));let a=s.z/Math.PI,o=.5*Math.log2(t/a);r.push(s.x,s.y,s.z,o)}return r};var q0={16:{2:26,8:20,32:17,128:16,512:16},32:{2:53,8:40,32:34,128:32,512:32},128:{2:214,8:163,32:139,128:130,512:128},1024:{2:1722,8:1310,32:1114,128:1041,512:1025}},$0=(l,e)=>{let t=q0[l];return t&&t[e]||l},K0=(l,e,t)=>{let s=t/l,r=1-Math.log2(e)/11,i=r*r,a=new y,o=new y,n=new y(0,0,1),c=[],h=$0(l,e);for(let d=0;d<h;++d){W0(a,d/h,Eh.radicalInverse(d),i);let f=a.z;if(o.set(a.x,a.y,a.z).mulScalar(2*f).sub(n),o.z>0){let u=X0(Math.min(1,f),i)/4+.001,m=.5*Math.log2(s/u);c.push(o.x,o.y,o.z,m)}}for(;c.length<l*4;)c.push(0,0,0,0);return c},Z0=(l,e,t)=>{let s=V0(t);return new se(l,{name:e,width:s.width,height:s.height,mipmaps:!1,minFilter:0,magFilter:0,levels:[s.data]})},Ch=class{constructor(e=!0){this.destroyContent=e}map=new Map;destroy(){this.destroyContent&&this.map.forEach((e,t)=>{e.destroy()})}get(e,t){if(!this.map.has(e)){let s=t();return this.map.set(e,s),s}return this.map.get(e)}},Q0=new Ch(!1),J0=new Se,Rm=(l,e,t)=>J0.get(l,()=>new Ch).get(e,()=>Z0(l,e,Q0.get(e,t))),eP=(l,e,t)=>{let s=`lambert-samples-${e}-${t}`;return Rm(l,s,()=>j0(e,t))},tP=(l,e,t)=>{let s=`phong-samples-${e}-${t}`;return Rm(l,s,()=>Y0(e,t))},sP=(l,e,t,s)=>{let r=`ggx-samples-${e}-${t}-${s}`;return Rm(l,r,()=>K0(e,t,s))};function Fs(l,e,t={}){let s=t.seamPixels??0,r=(t.rect?.z??e.width)-s*2,i=(t.rect?.w??e.height)-s*2;if(r<1||i<1)return!1;let a={none:"reproject",lambert:"prefilterSamplesUnweighted",phong:"prefilterSamplesUnweighted",ggx:"prefilterSamples"},o=t.hasOwnProperty("specularPower")?t.specularPower:1,n=t.hasOwnProperty("face")?t.face:null,c=t.hasOwnProperty("distribution")?t.distribution:o===1?"none":"phong",h=a[c]||"reproject",d=h.startsWith("prefilterSamples"),f=zt.decodeFunc(l.encoding),u=zt.encodeFunc(e.encoding),m=`sample${xS(l.projection)}`,_=`getDirection${xS(e.projection)}`,p=t.hasOwnProperty("numSamples")?t.numSamples:1024,g=`ReprojectShader:${h}_${f}_${u}_${m}_${_}_${p}`,T=l.device,S=hr(T).getCachedShader(g);if(!S){let A=new Map;d&&A.set("USE_SAMPLES_TEX",""),l.cubemap&&A.set("CUBEMAP_SOURCE",""),A.set("{PROCESS_FUNC}",h),A.set("{DECODE_FUNC}",f),A.set("{ENCODE_FUNC}",u),A.set("{SOURCE_FUNC}",m),A.set("{TARGET_FUNC}",_),A.set("{NUM_SAMPLES}",p),A.set("{NUM_SAMPLES_SQRT}",Math.round(Math.sqrt(p)).toFixed(1)),S=ot.createShader(T,{uniqueName:g,attributes:{vertex_position:le},vertexChunk:"reprojectVS",fragmentChunk:"reprojectPS",fragmentDefines:A})}T.setBlendState(Ve.NOBLEND),T.scope.resolve(l.cubemap?"sourceCube":"sourceTex").setValue(l);let C=T.scope.resolve("params"),E=T.scope.resolve("uvMod");s>0?E.setValue([(r+s*2)/r,(i+s*2)/i,-s/r,-s/i]):E.setValue([1,1,0,0]);let v=[0,e.width*e.height*(e.cubemap?6:1),l.width*l.height*(l.cubemap?6:1)];if(d){let A=l.width*l.height*(l.cubemap?6:1),D=c==="ggx"?sP(T,p,o,A):c==="lambert"?eP(T,p,A):tP(T,p,o);T.scope.resolve("samplesTex").setValue(D),T.scope.resolve("samplesTexInverseSize").setValue([1/D.width,1/D.height])}for(let A=0;A<(e.cubemap?6:1);A++)if(n===null||A===n){let D=new Le({colorBuffer:e,face:A,depth:!1,origin:pt});v[0]=A,C.setValue(v),ka(T,D,S,t?.rect,void 0,D.name),D.destroy()}return!0}var Pm=(l,e=0)=>1+Math.floor(Math.log2(Math.max(l,e))),rP=l=>l.textureHalfFloatRenderable,iP=l=>l.textureFloatRenderable,aP=l=>rP(l)?ge:iP(l)?We:Re,oP=l=>Re,nP=(l,e,t,s)=>new se(l,{name:`lighting-${e}`,cubemap:!0,width:e,height:e,format:t,type:t===Re?ra:At,addressU:1,addressV:1,mipmaps:!!s}),Wa=class{static generateSkyboxCubemap(e,t){let s=e.device,r=nP(s,t||(e.cubemap?e.width:e.width/4),Re,!1);return Fs(e,r,{numSamples:1024}),r}static generateLightingSource(e,t){let s=e.device,r=aP(s),i=t?.target||new se(s,{name:"lighting-source",cubemap:!0,width:t?.size||128,height:t?.size||128,format:r,type:r===Re?ra:At,addressU:1,addressV:1,mipmaps:!0});return Fs(e,i,{numSamples:e.mipmaps?1:1024}),i}static generateAtlas(e,t){let s=e.device,r=oP(s),i=t?.target||new se(s,{name:"envAtlas",width:t?.size||512,height:t?.size||512,format:r,type:r===Re?ra:At,projection:du,addressU:1,addressV:1,mipmaps:!1}),a=i.width/512,o=new ne(0,0,512*a,256*a),n=Pm(256)-Pm(4);for(let c=0;c<n;++c)Fs(e,i,{numSamples:1,rect:o,seamPixels:a}),o.x+=o.w,o.y+=o.w,o.z=Math.max(1,Math.floor(o.z*.5)),o.w=Math.max(1,Math.floor(o.w*.5));o.set(0,256*a,256*a,128*a);for(let c=1;c<7;++c)Fs(e,i,{numSamples:t?.numReflectionSamples||1024,distribution:t?.distribution||"ggx",specularPower:Math.max(1,2048>>c*2),rect:o,seamPixels:a}),o.y+=o.w,o.z=Math.max(1,Math.floor(o.z*.5)),o.w=Math.max(1,Math.floor(o.w*.5));return o.set(128*a,384*a,64*a,32*a),Fs(e,i,{numSamples:t?.numAmbientSamples||2048,distribution:"lambert",rect:o,seamPixels:a}),i}static generatePrefilteredAtlas(e,t){let s=e[0].device,r=e[0].format,i=e[0].type,a=t?.target||new se(s,{name:"envPrefilteredAtlas",width:t?.size||512,height:t?.size||512,format:r,type:i,projection:du,addressU:1,addressV:1,mipmaps:!1}),o=a.width/512,n=new ne(0,0,512*o,256*o),c=Pm(512);for(let h=0;h<c;++h)Fs(e[0],a,{numSamples:1,rect:n,seamPixels:o}),n.x+=n.w,n.y+=n.w,n.z=Math.max(1,Math.floor(n.z*.5)),n.w=Math.max(1,Math.floor(n.w*.5));n.set(0,256*o,256*o,128*o);for(let h=1;h<e.length;++h)Fs(e[h],a,{numSamples:1,rect:n,seamPixels:o}),n.y+=n.w,n.z=Math.max(1,Math.floor(n.z*.5)),n.w=Math.max(1,Math.floor(n.w*.5));return n.set(128*o,384*o,64*o,32*o),t?.legacyAmbient?Fs(e[5],a,{numSamples:1,rect:n,seamPixels:o}):Fs(e[0],a,{numSamples:t?.numSamples||2048,distribution:"lambert",rect:n,seamPixels:o}),a}};var Dm={vertex_normal:ys,vertex_tangent:ns,vertex_texCoord0:$i,vertex_texCoord1:Ki,vertex_texCoord2:Zi,vertex_texCoord3:Qi,vertex_texCoord4:Ji,vertex_texCoord5:ea,vertex_texCoord6:ta,vertex_texCoord7:sa,vertex_color:gt,vertex_boneWeights:Xt,vertex_boneIndices:Yt},vh=class{varyingsCode="";device;options;shaderLanguage;vDefines=new Map;fDefines=new Map;includes=new Map;chunks=null;constructor(e,t,s=!0){this.device=e,this.options=t;let r=t.shaderChunks;if(this.shaderLanguage=e.isWebGPU&&s&&(!r||r.useWGSL)?q:ce,e.isWebGPU&&this.shaderLanguage===ce&&e.hasTranspilers,this.attributes={vertex_position:le},t.userAttributes)for(let[a,o]of Object.entries(t.userAttributes))this.attributes[o]=a;let i=Ee.get(e,this.shaderLanguage);this.chunks=new Map(i),r&&(this.shaderLanguage===ce?r.glsl:r.wgsl).forEach((o,n)=>{for(let c in Dm)Dm.hasOwnProperty(c)&&o.indexOf(c)>=0&&(this.attributes[c]=Dm[c]);this.chunks.set(n,o)}),this.shaderPassInfo=at.get(this.device).getByIndex(t.pass),this.shadowPass=this.shaderPassInfo.isShadow,this.lighting=t.lights.length>0||t.dirLightMapEnabled||t.clusteredLightingEnabled,this.reflections=t.reflectionSource!==es,this.needsNormal=this.lighting||this.reflections||t.useRefraction||t.useSpecular||t.ambientSH||t.useHeights||t.enableGGXSpecular||t.clusteredLightingEnabled&&!this.shadowPass||t.useClearCoatNormals,this.needsNormal=this.needsNormal&&!this.shadowPass,this.needsSceneColor=t.useDynamicRefraction,this.needsScreenSize=t.useDynamicRefraction,this.needsTransforms=t.useDynamicRefraction,this.vshader=null,this.fshader=null}fDefineSet(e,t,s=""){e&&this.fDefines.set(t,s)}sharedDefineSet(e,t,s=""){e&&(this.vDefines.set(t,s),this.fDefines.set(t,s))}generateVertexShader(e,t,s){let{options:r,vDefines:i,attributes:a}=this,o=new Map;if(o.set("vPositionW","vec3"),(r.nineSlicedMode===an||r.nineSlicedMode===on)&&i.set("NINESLICED",!0),this.options.linearDepth&&(i.set("LINEAR_DEPTH",!0),o.set("vLinearDepth","float")),r.useRefraction&&r.useDynamicRefraction&&this.shaderPassInfo.isForward&&(i.set("LIT_DYNAMIC_REFRACTION",!0),o.set("vModelScale","vec3")),this.needsNormal&&i.set("NORMALS",!0),this.options.useInstancing){let f=Ee.get(this.device,this.shaderLanguage);this.chunks.get("transformInstancingVS")===f.get("transformInstancingVS")&&(a.instance_line1=Mo,a.instance_line2=Lo,a.instance_line3=bo,a.instance_line4=Ar)}this.needsNormal&&(a.vertex_normal=ys,o.set("vNormalW","vec3"),r.hasTangents&&(r.useHeights||r.useNormals||r.useClearCoatNormals||r.enableGGXSpecular)?(i.set("TANGENTS",!0),a.vertex_tangent=ns,o.set("vTangentW","vec3"),o.set("vBinormalW","vec3")):r.enableGGXSpecular&&(i.set("GGX_SPECULAR",!0),o.set("vObjectSpaceUpW","vec3")));let n=0,c=0;for(let f=0;f<e.length;f++)e[f]&&(i.set(`UV${f}`,!0),a[`vertex_texCoord${f}`]=`TEXCOORD${f}`,f>=2&&i.set(`{UV_SET_${n++}}`,f)),t[f]&&(i.set(`UV${f}_UNMODIFIED`,!0),o.set(`vUv${f}`,"vec2"),f>=2&&i.set(`{UV_VARYING_SET_${c++}}`,f));i.set("UV_SET_COUNT",n),i.set("UV_VARYING_SET_COUNT",c);let h=0,d=new Set;s.forEach(f=>{let{id:u,uv:m,name:_}=f,p=u+m*100;if(!d.has(p)){d.add(p),o.set(`vUV${m}_${u}`,"vec2");let g=`texture_${_}MapTransform`;i.set(`{TRANSFORM_NAME_${h}}`,g),i.set(`{TRANSFORM_UV_${h}}`,m),i.set(`{TRANSFORM_ID_${h}}`,u),h++}}),i.set("UV_TRANSFORMS_COUNT",h),r.vertexColors&&(a.vertex_color=gt,i.set("VERTEX_COLOR",!0),o.set("vVertexColor","vec4"),r.useVertexColorGamma&&i.set("STD_VERTEX_COLOR_GAMMA","")),r.useMsdf&&r.msdfTextAttribute&&(a.vertex_outlineParameters=cu,a.vertex_shadowParameters=hu,i.set("MSDF",!0)),(r.useMorphPosition||r.useMorphNormal)&&(this.sharedDefineSet(!0,"MORPHING",!0),this.sharedDefineSet(r.useMorphTextureBasedInt,"MORPHING_INT",!0),this.sharedDefineSet(r.useMorphPosition,"MORPHING_POSITION",!0),this.sharedDefineSet(r.useMorphNormal,"MORPHING_NORMAL",!0),a.morph_vertex_id=Ar),r.skin&&(a.vertex_boneIndices=Yt,r.batch?this.sharedDefineSet(!0,"BATCH",!0):(a.vertex_boneWeights=Xt,this.sharedDefineSet(!0,"SKIN",!0))),this.sharedDefineSet(r.useInstancing,"INSTANCING",!0),this.sharedDefineSet(r.screenSpace,"SCREENSPACE",!0),r.pixelSnap&&i.set("PIXELSNAP",!0),o.forEach((f,u)=>{this.varyingsCode+=`#define VARYING_${u.toUpperCase()}
`,this.varyingsCode+=this.shaderLanguage===q?`varying ${u}: ${Ql.get(f)};
`:`varying ${f} ${u};
`}),this.includes.set("varyingsVS",this.varyingsCode),this.includes.set("varyingsPS",this.varyingsCode),this.vshader=`
						#include "litMainVS"
				`}_setupLightingDefines(e,t){let s=this.fDefines,r=this.options;if(this.fDefines.set("LIGHT_COUNT",r.lights.length),e&&s.set("AREA_LIGHTS",!0),t&&this.lighting&&(s.set("LIT_CLUSTERED_LIGHTS",!0),r.clusteredLightingCookiesEnabled&&s.set("CLUSTER_COOKIES",!0),r.clusteredLightingAreaLightsEnabled&&s.set("CLUSTER_AREALIGHTS",!0),r.lightMaskDynamic&&s.set("CLUSTER_MESH_DYNAMIC_LIGHTS",!0),r.clusteredLightingShadowsEnabled&&!r.noShadow)){let i=Jt.get(r.clusteredLightingShadowType);s.set("CLUSTER_SHADOWS",!0),s.set(`SHADOW_KIND_${i.kind}`,!0),s.set(`CLUSTER_SHADOW_TYPE_${i.kind}`,!0)}for(let i=0;i<r.lights.length;i++){let a=r.lights[i];if(!a)continue;let o=a._type;if(t&&o!==te)continue;let n=e&&a._shape?a._shape:Qt,c=a._shadowType,h=a.castShadows&&!r.noShadow,d=Jt.get(c);s.set(`LIGHT${i}`,!0),s.set(`LIGHT${i}TYPE`,`${Hc[o]}`),s.set(`LIGHT${i}SHADOWTYPE`,`${d.name}`),s.set(`LIGHT${i}SHAPE`,`${mg[n]}`),s.set(`LIGHT${i}FALLOFF`,`${pg[a._falloffMode]}`),a.affectSpecularity&&s.set(`LIGHT${i}AFFECT_SPECULARITY`,!0),a._cookie&&(o===Ue&&!a._cookie._cubemap||o===ze&&a._cookie._cubemap)&&(s.set(`LIGHT${i}COOKIE`,!0),s.set(`{LIGHT${i}COOKIE_CHANNEL}`,a._cookieChannel),o===Ue&&(a._cookieTransform&&s.set(`LIGHT${i}COOKIE_TRANSFORM`,!0),a._cookieFalloff&&s.set(`LIGHT${i}COOKIE_FALLOFF`,!0))),h&&(s.set(`LIGHT${i}CASTSHADOW`,!0),d.pcf&&s.set(`LIGHT${i}SHADOW_PCF`,!0),a._normalOffsetBias&&!a._isVsm&&s.set(`LIGHT${i}_SHADOW_SAMPLE_NORMAL_OFFSET`,!0),o===te&&(s.set(`LIGHT${i}_SHADOW_SAMPLE_ORTHO`,!0),a.cascadeBlend>0&&s.set(`LIGHT${i}_SHADOW_CASCADE_BLEND`,!0),a.numCascades>1&&s.set(`LIGHT${i}_SHADOW_CASCADES`,!0)),(d.pcf||d.pcss||this.device.isWebGPU)&&s.set(`LIGHT${i}_SHADOW_SAMPLE_SOURCE_ZBUFFER`,!0),o===ze&&s.set(`LIGHT${i}_SHADOW_SAMPLE_POINT`,!0)),h&&(s.set(`SHADOW_KIND_${d.kind}`,!0),o===te&&s.set("SHADOW_DIRECTIONAL",!0))}}prepareForwardPass(e){let{options:t}=this,r=t.clusteredLightingEnabled&&t.clusteredLightingAreaLightsEnabled||t.lights.some(o=>o._shape&&o._shape!==Qt),i=!t.lightMapEnabled||t.lightMapWithoutAmbient,a=this.needsNormal&&(t.useNormals||t.useClearCoatNormals||t.useHeights||t.enableGGXSpecular);t.useSpecular&&(this.fDefineSet(!0,"LIT_SPECULAR"),this.fDefineSet(this.reflections,"LIT_REFLECTIONS"),this.fDefineSet(t.useClearCoat,"LIT_CLEARCOAT"),this.fDefineSet(t.fresnelModel>0,"LIT_SPECULAR_FRESNEL"),this.fDefineSet(t.useSheen,"LIT_SHEEN"),this.fDefineSet(t.useIridescence,"LIT_IRIDESCENCE")),this.fDefineSet(this.lighting&&t.useSpecular||this.reflections,"LIT_SPECULAR_OR_REFLECTION"),this.fDefineSet(this.needsSceneColor,"LIT_SCENE_COLOR"),this.fDefineSet(this.needsScreenSize,"LIT_SCREEN_SIZE"),this.fDefineSet(this.needsTransforms,"LIT_TRANSFORMS"),this.fDefineSet(this.needsNormal,"LIT_NEEDS_NORMAL"),this.fDefineSet(this.lighting,"LIT_LIGHTING"),this.fDefineSet(t.useMetalness,"LIT_METALNESS"),this.fDefineSet(t.enableGGXSpecular,"LIT_GGX_SPECULAR"),this.fDefineSet(t.useAnisotropy,"LIT_ANISOTROPY"),this.fDefineSet(t.useSpecularityFactor,"LIT_SPECULARITY_FACTOR"),this.fDefineSet(t.useCubeMapRotation,"CUBEMAP_ROTATION"),this.fDefineSet(t.occludeSpecularFloat,"LIT_OCCLUDE_SPECULAR_FLOAT"),this.fDefineSet(t.separateAmbient,"LIT_SEPARATE_AMBIENT"),this.fDefineSet(t.twoSidedLighting,"LIT_TWO_SIDED_LIGHTING"),this.fDefineSet(t.lightMapEnabled,"LIT_LIGHTMAP"),this.fDefineSet(t.dirLightMapEnabled,"LIT_DIR_LIGHTMAP"),this.fDefineSet(t.skyboxIntensity>0,"LIT_SKYBOX_INTENSITY"),this.fDefineSet(t.clusteredLightingShadowsEnabled,"LIT_CLUSTERED_SHADOWS"),this.fDefineSet(t.clusteredLightingAreaLightsEnabled,"LIT_CLUSTERED_AREA_LIGHTS"),this.fDefineSet(a,"LIT_TBN"),this.fDefineSet(i,"LIT_ADD_AMBIENT"),this.fDefineSet(t.hasTangents,"LIT_TANGENTS"),this.fDefineSet(t.useNormals,"LIT_USE_NORMALS"),this.fDefineSet(t.useClearCoatNormals,"LIT_USE_CLEARCOAT_NORMALS"),this.fDefineSet(t.useRefraction,"LIT_REFRACTION"),this.fDefineSet(t.useDynamicRefraction,"LIT_DYNAMIC_REFRACTION"),this.fDefineSet(t.dispersion,"LIT_DISPERSION"),this.fDefineSet(t.useHeights,"LIT_HEIGHTS"),this.fDefineSet(t.opacityFadesSpecular,"LIT_OPACITY_FADES_SPECULAR"),this.fDefineSet(t.alphaToCoverage,"LIT_ALPHA_TO_COVERAGE"),this.fDefineSet(t.alphaTest,"LIT_ALPHA_TEST"),this.fDefineSet(t.useMsdf,"LIT_MSDF"),this.fDefineSet(t.ssao,"LIT_SSAO"),this.fDefineSet(t.useAo,"LIT_AO"),this.fDefineSet(t.occludeDirect,"LIT_OCCLUDE_DIRECT"),this.fDefineSet(t.msdfTextAttribute,"LIT_MSDF_TEXT_ATTRIBUTE"),this.fDefineSet(t.diffuseMapEnabled,"LIT_DIFFUSE_MAP"),this.fDefineSet(t.shadowCatcher,"LIT_SHADOW_CATCHER"),this.fDefineSet(!0,"LIT_FRESNEL_MODEL",dg[t.fresnelModel]),this.fDefineSet(!0,"LIT_NONE_SLICE_MODE",Pg[t.nineSlicedMode]),this.fDefineSet(!0,"LIT_BLEND_TYPE",hg[t.blendType]),this.fDefineSet(!0,"LIT_CUBEMAP_PROJECTION",Sg[t.cubeMapProjection]),this.fDefineSet(!0,"LIT_OCCLUDE_SPECULAR",yg[t.occludeSpecular]),this.fDefineSet(!0,"LIT_REFLECTION_SOURCE",Cg[t.reflectionSource]),this.fDefineSet(!0,"LIT_AMBIENT_SOURCE",vg[t.ambientSource]),this.fDefineSet(!0,"{lightingUv}",e??""),this.fDefineSet(!0,"{reflectionDecode}",zt.decodeFunc(t.reflectionEncoding)),this.fDefineSet(!0,"{reflectionCubemapDecode}",zt.decodeFunc(t.reflectionCubemapEncoding)),this.fDefineSet(!0,"{ambientDecode}",zt.decodeFunc(t.ambientEncoding)),this.fDefineSet(!0,"{LIT_ENV_ATLAS}",t.useSceneEnv?"scene_envAtlas":"texture_envAtlas"),this.fDefineSet(!0,"{LIT_ENV_CUBEMAP}",t.useSceneEnv?"scene_skybox":"texture_cubeMap"),this._setupLightingDefines(r,t.clusteredLightingEnabled)}preparePrepassPass(){let{options:e}=this;this.fDefineSet(e.alphaTest,"LIT_ALPHA_TEST"),this.fDefineSet(!0,"STD_OPACITY_DITHER",Ai[e.opacityShadowDither])}prepareShadowPass(){let{options:e}=this;this.fDefineSet(e.alphaTest,"LIT_ALPHA_TEST")}generateFragmentShader(e,t,s){let r=this.options;this.includes.set("frontendDeclPS",e??""),this.includes.set("frontendCodePS",t??""),r.pass===vi||(r.pass===ps?this.preparePrepassPass():this.shadowPass?this.prepareShadowPass():this.prepareForwardPass(s)),this.fshader=`
						#include "litMainPS"
				`}};var Sn=class{hasTangents=!1;shaderChunks=null;pass=0;alphaTest=!1;blendType=tt;separateAmbient=!1;screenSpace=!1;skin=!1;batch=!1;useInstancing=!1;useMorphPosition=!1;useMorphNormal=!1;useMorphTextureBasedInt=!1;nineSlicedMode=0;clusteredLightingEnabled=!0;clusteredLightingCookiesEnabled=!1;clusteredLightingShadowsEnabled=!1;clusteredLightingShadowType=0;clusteredLightingAreaLightsEnabled=!1;vertexColors=!1;useVertexColorGamma=!1;lightMapEnabled=!1;dirLightMapEnabled=!1;useHeights=!1;useNormals=!1;useClearCoatNormals=!1;useAo=!1;diffuseMapEnabled=!1;pixelSnap=!1;ambientSH=!1;ssao=!1;twoSidedLighting=!1;occludeDirect=!1;occludeSpecular=0;occludeSpecularFloat=!1;useMsdf=!1;msdfTextAttribute=!1;alphaToCoverage=!1;opacityFadesSpecular=!1;opacityDither=Ut;opacityShadowDither=Ut;cubeMapProjection=0;useSpecular=!1;useSpecularityFactor=!1;enableGGXSpecular=!1;fresnelModel=0;useRefraction=!1;useClearCoat=!1;useSheen=!1;useIridescence=!1;useMetalness=!1;useDynamicRefraction=!1;dispersion=!1;fog=Is;gamma=Jo;toneMap=-1;reflectionSource=es;reflectionEncoding=null;reflectionCubemapEncoding=null;ambientSource="constant";ambientEncoding=null;skyboxIntensity=1;useCubeMapRotation=!1;useSceneEnv=!1;lightMapWithoutAmbient=!1;lights=[];noShadow=!1;lightMaskDynamic=0;userAttributes={};linearDepth=!1;shadowCatcher=!1};var Xa=class{defines=new Map;useDualSourceBlending=!1;forceUv1=!1;metalnessTint=!1;glossTint=!1;emissiveEncoding="linear";lightMapEncoding="linear";useInstanceLightMap=!1;vertexColorGamma=!1;packedNormal=!1;normalDetailPackedNormal=!1;clearCoatPackedNormal=!1;glossInvert=!1;sheenGlossInvert=!1;clearCoatGlossInvert=!1;useAO=!1;litOptions=new Sn;get pass(){return this.litOptions.pass}};function RS(l,e){l!=="pass"&&Object.defineProperty(Xa.prototype,l,{get:function(){return this.litOptions[e||l]},set:function(t){this.litOptions[e||l]=t}})}RS("refraction","useRefraction");var lP=new Sn,AS=Object.getOwnPropertyNames(lP);for(let l in AS)RS(AS[l]);var Im={generateKey(l){return`lit${Object.keys(l).sort().map(e=>e==="shaderChunks"?l.shaderChunks?.key??"":e==="lights"?Im.generateLightsKey(l):e+l[e]).join(`
`)}`},generateLightsKey(l){let e=l.lights,t="lights:";for(let s=0;s<e.length;s++){let r=e[s];r&&(!l.clusteredLightingEnabled||r._type===te)&&(t+=`${s}:${r.key},`)}return t}};var yt=new Map,wm=l=>Object.keys(l).filter(e=>e!=="litOptions").sort(),Mm=class extends Ls{optionsContext=new Xa;optionsContextMin=new Xa;generateKey(e){let t;return e===this.optionsContextMin?(this.propsMin||(this.propsMin=wm(e)),t=this.propsMin):e===this.optionsContext?(this.props||(this.props=wm(e)),t=this.props):t=wm(e),`standard:
${Ls.definesHash(e.defines)}
${t.map(i=>i+e[i]).join(`
`)}${Im.generateKey(e.litOptions)}`}_getUvSourceExpression(e,t,s,r=!0){let i=s[e],a=s[t],o=s.litOptions.pass===jr,n;return o&&s.litOptions.nineSlicedMode===an||o&&s.litOptions.nineSlicedMode===on?n="nineSlicedUv":(i===0?n=`vUv${a}`:n=`vUV${a}_${i}`,o&&r&&s.heightMap&&e!=="heightMapTransform"&&(n+=" + dUvOffset")),n}_validateMapChunk(e,t,s,r){}_addMapDefines(e,t,s,r,i,a,o=null,n=null){let c=`${t}Map`,h=t.toUpperCase(),d=`${c}Uv`,f=`${c}Identifier`,u=`${c}Transform`,m=`${c}Channel`,_=`${t}VertexColorChannel`,p=`${t}Tint`,g=`${t}VertexColor`,T=`${t}Mode`,S=`${t}Invert`,x=r[p],C=r[g],E=r[c],v=r[f],A=r[T],D=i.get(s);if(E){e.set(`STD_${h}_TEXTURE`,"");let R=this._getUvSourceExpression(u,d,r);e.set(`{STD_${h}_TEXTURE_UV}`,R),e.set(`{STD_${h}_TEXTURE_CHANNEL}`,r[m]);let w=`{STD_${h}_TEXTURE_NAME}`;if(D.includes(w)){let M=n;if(M)e.set(`STD_${h}_TEXTURE_ALLOCATE`,"");else{M=`texture_${c}`;let P=a[v];P?M=P:(a[v]=M,e.set(`STD_${h}_TEXTURE_ALLOCATE`,""))}e.set(w,M)}if(o){let M=r[m]==="aaa"?"passThrough":zt.decodeFunc(o);e.set(`{STD_${h}_TEXTURE_DECODE}`,M)}}C&&(e.set(`STD_${h}_VERTEX`,""),e.set(`{STD_${h}_VERTEX_CHANNEL}`,r[_])),A&&e.set(`{STD_${h}_DETAILMODE}`,A),x&&e.set(`STD_${h}_CONSTANT`,""),r[S]&&e.set(`STD_${h}_INVERT`,"")}_correctChannel(e,t,s){let r=s.get(e);if(r>0){if(r<t.length)return t.substring(0,r);if(r>t.length){let i=t,a=i.charAt(i.length-1),o=r-i.length;for(let n=0;n<o;n++)i+=a;return i}return t}}createVertexShader(e,t){let s=[],r=[],i=[];for(let o of yt.keys()){let n=`${o}Map`;if(t[`${o}VertexColor`]){let c=`${o}VertexColorChannel`;t[c]=this._correctChannel(o,t[c],yt)}if(t[n]){let c=`${n}Channel`,h=`${n}Transform`,d=`${n}Uv`;t[d]=Math.min(t[d],7),t[c]=this._correctChannel(o,t[c],yt);let f=t[d];s[f]=!0,r[f]=r[f]||t[n]&&!t[h],t[h]&&i.push({name:o,id:t[h],uv:t[d]})}}t.forceUv1&&(s[1]=!0,r[1]=r[1]!==void 0?r[1]:!0),e.generateVertexShader(s,r,i)}prepareFragmentDefines(e,t,s){let r=(i,a,o="")=>{i&&t.set(a,o)};r(e.lightMap,"STD_LIGHTMAP",""),r(e.lightVertexColor,"STD_LIGHT_VERTEX_COLOR",""),r(e.dirLightMap&&e.litOptions.useSpecular,"STD_LIGHTMAP_DIR",""),r(e.heightMap,"STD_HEIGHT_MAP",""),r(!0,"STD_PARALLAX",Og[e.parallaxMode??xi]),r(e.parallaxSelfShadow,"STD_PARALLAX_SELF_SHADOW",""),r(e.useSpecularColor,"STD_SPECULAR_COLOR",""),r(e.useSpecularColor&&(e.litOptions.useSpecular||e.litOptions.useRefraction),"STD_SPECULAR_CONSTANT",""),r(e.aoMap||e.aoVertexColor||e.useAO,"STD_AO",""),r(!0,"STD_OPACITY_DITHER",Ai[s.isForward?e.litOptions.opacityDither:e.litOptions.opacityShadowDither])}createShaderDefinition(e,t){let s=at.get(e).getByIndex(t.litOptions.pass),r=s.isForward,i=new vh(e,t.litOptions);this.createVertexShader(i,t);let a={};t.litOptions.fresnelModel=t.litOptions.fresnelModel===0?$o:t.litOptions.fresnelModel;let o=i.fDefines;this.prepareFragmentDefines(t,o,s);let n="";if(r){if(t.heightMap&&this._addMapDefines(o,"height","parallaxPS",t,i.chunks,a),(t.litOptions.blendType!==tt||t.litOptions.alphaTest||t.litOptions.alphaToCoverage||t.litOptions.opacityDither!==Ut)&&this._addMapDefines(o,"opacity","opacityPS",t,i.chunks,a),i.needsNormal){if((t.normalMap||t.clearCoatNormalMap||t.heightMap)&&!t.litOptions.hasTangents){let f=t.normalMap?"normalMap":t.clearCoatNormalMap?"clearCoatNormalMap":"heightMap";n=this._getUvSourceExpression(`${f}Transform`,`${f}Uv`,t,!1)}this._addMapDefines(o,"normalDetail","normalMapPS",t,i.chunks,a,t.normalDetailPackedNormal?"xy":"xyz"),this._addMapDefines(o,"normal","normalMapPS",t,i.chunks,a,t.packedNormal?"xy":"xyz")}if(t.diffuseDetail&&this._addMapDefines(o,"diffuseDetail","diffusePS",t,i.chunks,a,t.diffuseDetailEncoding),this._addMapDefines(o,"diffuse","diffusePS",t,i.chunks,a,t.diffuseEncoding),t.litOptions.useRefraction&&(this._addMapDefines(o,"refraction","transmissionPS",t,i.chunks,a),this._addMapDefines(o,"thickness","thicknessPS",t,i.chunks,a),t.litOptions.useMetalness||this._addMapDefines(o,"ior","iorPS",t,i.chunks,a)),t.litOptions.useIridescence&&(this._addMapDefines(o,"iridescence","iridescencePS",t,i.chunks,a),this._addMapDefines(o,"iridescenceThickness","iridescenceThicknessPS",t,i.chunks,a)),(i.lighting&&t.litOptions.useSpecular||i.reflections||t.litOptions.useRefraction)&&(t.litOptions.useSheen&&(this._addMapDefines(o,"sheen","sheenPS",t,i.chunks,a,t.sheenEncoding),this._addMapDefines(o,"sheenGloss","sheenGlossPS",t,i.chunks,a)),t.litOptions.useMetalness&&(this._addMapDefines(o,"metalness","metalnessPS",t,i.chunks,a),this._addMapDefines(o,"ior","iorPS",t,i.chunks,a)),t.litOptions.useSpecularityFactor&&this._addMapDefines(o,"specularityFactor","specularityFactorPS",t,i.chunks,a),t.useSpecularColor&&this._addMapDefines(o,"specular","specularPS",t,i.chunks,a,t.specularEncoding),this._addMapDefines(o,"gloss","glossPS",t,i.chunks,a)),t.aoDetail&&this._addMapDefines(o,"aoDetail","aoPS",t,i.chunks,a),(t.aoMap||t.aoVertexColor||t.useAO)&&this._addMapDefines(o,"ao","aoPS",t,i.chunks,a),this._addMapDefines(o,"emissive","emissivePS",t,i.chunks,a,t.emissiveEncoding),t.litOptions.useClearCoat&&(this._addMapDefines(o,"clearCoat","clearCoatPS",t,i.chunks,a),this._addMapDefines(o,"clearCoatGloss","clearCoatGlossPS",t,i.chunks,a),this._addMapDefines(o,"clearCoatNormal","clearCoatNormalPS",t,i.chunks,a,t.clearCoatPackedNormal?"xy":"xyz")),t.litOptions.enableGGXSpecular&&this._addMapDefines(o,"anisotropy","anisotropyPS",t,i.chunks,a),t.lightMap||t.lightVertexColor){let f=t.useInstanceLightMap?rh[0]:null;this._addMapDefines(o,"light","lightmapPS",t,i.chunks,a,t.lightMapEncoding,f)}}else{let f=t.litOptions.opacityShadowDither;(t.litOptions.alphaTest||f)&&this._addMapDefines(o,"opacity","opacityPS",t,i.chunks,a)}i.generateFragmentShader(i.chunks.get("stdDeclarationPS"),i.chunks.get("stdFrontEndPS"),n);let c=dr.merge(i.chunks,i.includes),h=i.vDefines;t.defines.forEach((f,u)=>h.set(u,f)),t.defines.forEach((f,u)=>o.set(u,f));let d=It.createDefinition(e,{name:"StandardShader",attributes:i.attributes,shaderLanguage:i.shaderLanguage,vertexCode:i.vshader,fragmentCode:i.fshader,vertexIncludes:c,fragmentIncludes:c,fragmentDefines:o,vertexDefines:h,useDualSourceBlending:t.useDualSourceBlending});return i.shaderPassInfo.isForward&&(d.tag=__),d}},xh=new Mm;var Lm=class{constructor(e,t,s,r){this.key=t,this.uniformBufferFormat=new Te(e,s.map(i=>new I(i.uniformName,i.type,i.count)),{pack:!0}),this.textures=r,this.bindGroupFormat=new Ae(e,[new De(kr,Qs|Js),...r.map(i=>new Ds(i.name,Qs|Js,void 0,void 0,!0,i.samplerName))])}destroy(){this.bindGroupFormat.destroy()}},bm=class extends Map{destroy(){this.forEach(e=>e.destroy()),this.clear()}},cP=new Se,PS=l=>l.slice().sort((e,t)=>e.key<t.key?-1:e.key>t.key?1:0),hP=(l,e=[])=>`${PS(l).map(t=>t.key).join(",")}|${e.map(t=>t.name).join(",")}`,Ah=(l,e,t=[])=>{let s=cP.get(l,()=>new bm),r=PS(e),i=hP(r,t),a=s.get(i);return a||(a=new Lm(l,i,r,t),s.set(i,a)),a};var Mt=[];Mt[Wu]={src:1,dst:1,op:2};Mt[tt]={src:1,dst:0,op:0};Mt[va]={src:6,dst:8,op:0,alphaSrc:1};Mt[fs]={src:1,dst:8,op:0};Mt[ir]={src:1,dst:1,op:0};Mt[qo]={src:6,dst:1,op:0};Mt[Yu]={src:4,dst:2,op:0};Mt[ju]={src:5,dst:1,op:0};Mt[Xu]={src:4,dst:0,op:0};Mt[qu]={src:1,dst:1,op:3};Mt[$u]={src:1,dst:1,op:4};var _P=0,Os=class l{meshInstances=new Set;name="Untitled";userId="";id=_P++;variants=new Map;defines=new Map;_definesDirty=!1;_definesKey=null;parameters={};_alphaTest=0;alphaToCoverage=!1;_blendState=new Ve;_sceneTexturesWrite;_depthState=new Ot;cull=1;frontFace=0;stencilFront=null;stencilBack=null;_shaderChunks=null;_oldChunks={};_dirtyShader=!0;_usesViewTextures=!1;constructor(){new.target}set flatShading(e){this.setDefine("FLAT_SHADING",e)}get flatShading(){return this.defines.has("FLAT_SHADING")}get hasShaderChunks(){return this._shaderChunks!=null}get shaderChunks(){return this._shaderChunks||(this._shaderChunks=new Ee),this._shaderChunks}getShaderChunks(e=ce){let t=this.shaderChunks;return e===ce?t.glsl:t.wgsl}set shaderChunksVersion(e){this.shaderChunks.version=e}get shaderChunksVersion(){return this.shaderChunks.version}set chunks(e){this._oldChunks=e}get chunks(){return Object.assign(this._oldChunks,Object.fromEntries(this.shaderChunks.glsl)),this._oldChunks}set alphaTest(e){this._alphaTest=e}get alphaTest(){return this._alphaTest}set depthBias(e){this._depthState.depthBias=e}get depthBias(){return this._depthState.depthBias}set slopeDepthBias(e){this._depthState.depthBiasSlope=e}get slopeDepthBias(){return this._depthState.depthBiasSlope}_shaderVersion=0;_scene=null;_updateVersion=0;_preparedVersion=-1;_modifiedProperties=null;_mutableProperties=null;_uniformBuffer=null;_uniformBufferBindGroup=null;_layout=null;_textureAssignmentVersion=0;_resolvedTextureVersion=-1;_uniformDataVersion=0;_uniformUploadedVersion=-1;get updateVersion(){return this._updateVersion}get propertyDescriptors(){return null}getUniformBufferProperty(e){return null}get textureDescriptors(){return[]}getTextureDescriptors(e){return e.usesMeshBindGroups?this.textureDescriptors:[]}getTextureSlot(e){return this._uniformBufferBindGroup?.format.textureFormatsMap.get(e)??-1}_layoutVersion=0;_layoutDirty=!1;get layoutVersion(){return this._layoutVersion}_markLayoutDirty(){this._layoutDirty=!0}get uniformBufferBindGroup(){return this._uniformBufferBindGroup}get uniformBuffer(){return this._uniformBuffer}get uniformDataVersion(){return this._uniformDataVersion}get dirty(){}set redWrite(e){this._blendState.redWrite=e}get redWrite(){return this._blendState.redWrite}set greenWrite(e){this._blendState.greenWrite=e}get greenWrite(){return this._blendState.greenWrite}set blueWrite(e){this._blendState.blueWrite=e}get blueWrite(){return this._blendState.blueWrite}set alphaWrite(e){this._blendState.alphaWrite=e}get alphaWrite(){return this._blendState.alphaWrite}get transparent(){return this._blendState.blend}set sceneTexturesWrite(e){this._sceneTexturesWrite=e}get sceneTexturesWrite(){return this._sceneTexturesWrite??!this.transparent}_updateTransparency(){for(let e of this.meshInstances)e.transparent=this.transparent}set blendState(e){let t=this._blendState.usesDualSourceBlending;this._blendState.copy(e),this._updateTransparency(),t!==this._blendState.usesDualSourceBlending&&this.clearVariants()}get blendState(){return this._blendState}set blendType(e){let t=this._blendState.usesDualSourceBlending,s=Mt[e];this._blendState.setColorBlend(s.op,s.src,s.dst),this._blendState.setAlphaBlend(s.alphaOp??s.op,s.alphaSrc??s.src,s.alphaDst??s.dst);let r=e!==tt;this._blendState.blend!==r&&(this._blendState.blend=r,this._updateTransparency()),this._updateMeshInstanceKeys(),t!==this._blendState.usesDualSourceBlending&&this.clearVariants()}get blendType(){if(!this.transparent)return tt;let{colorOp:e,colorSrcFactor:t,colorDstFactor:s,alphaOp:r,alphaSrcFactor:i,alphaDstFactor:a}=this._blendState;for(let o=0;o<Mt.length;o++){let n=Mt[o];if(n.src===t&&n.dst===s&&n.op===e&&n.src===i&&n.dst===a&&n.op===r)return o}return va}set depthState(e){this._depthState.copy(e)}get depthState(){return this._depthState}set depthTest(e){this._depthState.test=e}get depthTest(){return this._depthState.test}set depthFunc(e){this._depthState.func=e}get depthFunc(){return this._depthState.func}set depthWrite(e){this._depthState.write=e}get depthWrite(){return this._depthState.write}copy(e){this.name=e.name,this.alphaTest=e.alphaTest,this.alphaToCoverage=e.alphaToCoverage,this._blendState.copy(e._blendState),this._depthState.copy(e._depthState),this._sceneTexturesWrite=e._sceneTexturesWrite,this.cull=e.cull,this.frontFace=e.frontFace,this.stencilFront=e.stencilFront?.clone(),e.stencilBack&&(this.stencilBack=e.stencilFront===e.stencilBack?this.stencilFront:e.stencilBack.clone()),this.clearParameters();for(let t in e.parameters)e.parameters.hasOwnProperty(t)&&this._setParameterSimple(t,e.parameters[t].data);return this.defines.clear(),e.defines.forEach((t,s)=>this.defines.set(s,t)),this._definesKey=null,this._shaderChunks=e.hasShaderChunks?new Ee:null,this._shaderChunks?.copy(e._shaderChunks),this}clone(){return new this.constructor().copy(this)}_updateMeshInstanceKeys(){for(let e of this.meshInstances)e.updateKey()}_clearVariantsIfDirty(){this._dirtyShader&&(this.clearVariants(),this._dirtyShader=!1)}updateUniforms(e,t){this._clearVariantsIfDirty()}_markPropertyModified(e){this._modifiedProperties??(this._modifiedProperties=new Set),this._modifiedProperties.add(e)}_markPropertyMutable(e,t){this._mutableProperties??(this._mutableProperties=new Map),this._mutableProperties.has(e)||this._mutableProperties.set(e,t.clone())}_updateProperties(){let e=this._mutableProperties;if(e)for(let[r,i]of e){let a=this[r.backingName];i.equals(a)||(i.copy(a),this._markPropertyModified(r))}let t=this._modifiedProperties,s=this._uniformBuffer;if(t?.size&&s){let r=s.storageFloat32,i=s.format;for(let a of t){let o=i.get(a.uniformName);o&&a.convert(this[a.backingName],r,o.offset,this)}t.clear(),this._uniformDataVersion++}}_prepareUniformBuffer(e){let t=this.propertyDescriptors;if(!t)return;this._resolvedTextureVersion!==this._textureAssignmentVersion&&(this._resolvedTextureVersion=this._textureAssignmentVersion,this._layoutDirty=!0);let s=this._uniformBuffer;if(!s||this._layoutDirty){this._layoutDirty=!1;let i=Ah(e,t,this.getTextureDescriptors(e));this._layout=i;let a=!!this._uniformBufferBindGroup&&this._uniformBufferBindGroup.format!==i.bindGroupFormat;if(s?.format!==i.uniformBufferFormat||this._uniformBufferBindGroup?.format!==i.bindGroupFormat){this._uniformBufferBindGroup?.destroy(),s?.destroy(),s=new Nt(e,i.uniformBufferFormat,!0),this._uniformBuffer=s,this._uniformBufferBindGroup=new bt(e,i.bindGroupFormat,s),this._layoutVersion++,this._modifiedProperties??(this._modifiedProperties=new Set);for(let o of t)this._modifiedProperties.add(o);this._updateProperties(),this._uniformUploadedVersion=-1,a&&this.clearVariants()}}this._uniformUploadedVersion!==this._uniformDataVersion&&(s.upload(),this._uniformUploadedVersion=this._uniformDataVersion);let r=this._layout.textures;for(let i=0;i<r.length;i++)this._uniformBufferBindGroup.setTextureAt(i,this[r[i].mapName]??e.builtInTextures.white);this._uniformBufferBindGroup.commit()}prepareForRender(e,t){let s=this._updateVersion;this._preparedVersion!==s&&(this.updateUniforms(e,t),this._preparedVersion=s),this._prepareUniformBuffer(e)}getShaderVariant(e){}update(){if(Object.keys(this._oldChunks).length>0)for(let[e,t]of Object.entries(this._oldChunks))this.shaderChunks.glsl.set(e,t),delete this._oldChunks[e];(this._definesDirty||this._shaderChunks?.isDirty())&&(this._definesDirty=!1,this._shaderChunks?.resetDirty(),this._dirtyShader=!0),this._clearVariantsIfDirty(),this._updateProperties(),this._updateVersion++}clearParameters(){this.parameters={}}getParameters(){return this.parameters}clearVariants(){this.variants.clear();for(let e of this.meshInstances)e.clearShaders()}getParameter(e){return this.parameters[e]}_setParameterSimple(e,t){let s=this.parameters[e];s?s.data=t:this.parameters[e]={scopeId:null,data:t}}setParameter(e,t){if(t===void 0&&typeof e=="object"){let s=e;if(s.length){for(let r=0;r<s.length;r++)this.setParameter(s[r]);return}e=s.name,t=s.value}this._setParameterSimple(e,t)}deleteParameter(e){this.parameters[e]&&delete this.parameters[e]}setParameters(e,t){let s=this.parameters;if(t)for(let r=0;r<t.length;r++){let i=s[t[r].name];i&&this._setScopeParameter(e,i,t[r].name)}else for(let r in s)this._setScopeParameter(e,s[r],r)}_setScopeParameter(e,t,s){t.scopeId||(t.scopeId=e.scope.resolve(s)),t.scopeId.setValue(t.data)}setDefine(e,t){let s=!1,{defines:r}=this;t!==void 0&&t!==!1?(s=!r.has(e)||r.get(e)!==t,r.set(e,t)):(s=r.has(e),r.delete(e)),this._definesDirty||(this._definesDirty=s),s&&(this._definesKey=null)}get definesKey(){return this._definesKey===null&&(this._definesKey=Array.from(this.defines).sort(([e],[t])=>e<t?-1:e>t?1:0).map(([e,t])=>`${e}=${t}`).join(",")),this._definesKey}getDefine(e){return this.defines.has(e)}destroy(){this.variants.clear(),this._uniformBufferBindGroup?.destroy(),this._uniformBufferBindGroup=null,this._uniformBuffer?.destroy(),this._uniformBuffer=null;for(let e of this.meshInstances)if(e.clearShaders(),e._material=null,e.mesh){let t=Va(e.mesh.device);this!==t&&(e.material=t)}this.meshInstances.clear()}addMeshInstanceRef(e){this.meshInstances.add(e)}removeMeshInstanceRef(e){this.meshInstances.delete(e)}set shader(e){}get shader(){return null}set blend(e){this.blendState.blend=e}get blend(){return this.blendState.blend}};var Rh=new z,Q=class{name;backingName;uniformName;type;count;convert;key;constructor(e,t,s,r,i=0){this.name=e,this.backingName=`_${e}`,this.uniformName=t,this.type=s,this.convert=r,this.count=i,this.key=`${t}:${s}:${i}`}},Mi=(l,e,t)=>{Rh.linear(l),e[t]=Rh.r,e[t+1]=Rh.g,e[t+2]=Rh.b},we=(l,e,t)=>{e[t]=l};var Ph=l=>{let e=new Map,t=new Map;for(let s of yt.keys()){let r=l[`${s}Map`];if(r){let i=t.get(r.id);i===void 0?(t.set(r.id,s),e.set(s,s)):e.set(s,i)}}return e},IS=l=>{let e="";return Ph(l).forEach((t,s)=>{t!==s&&(e+=`${s}:${t};`)}),e},wS=l=>{let e=[];return Ph(l).forEach((t,s)=>{if(t===s){let r=`texture_${s}Map`;e.push({name:r,samplerName:`${r}Sampler`,mapName:`${s}Map`})}}),e};var MS=new Map,LS=new Map,Fm=l=>{let e=MS.get(l);if(!e){e=[0,1].map(t=>new Q(`${l}MapTransform`,`texture_${l}MapTransform${t}`,Z,(s,r,i,a)=>{a._mapTransforms.write(l,t,r,i)})),MS.set(l,e);for(let t of e)LS.set(t.uniformName,l)}return e},gP=(l,e)=>l[0]===e[0]&&l[1]===e[1]&&l[2]===e[2]&&l[3]===e[3]&&l[4]===e[4]&&l[5]===e[5],Dh=class{_dirty=!0;_mutable=!1;_ids=new Map;_states=new Map;_values=new Map;_descriptors=null;reset(){this._ids.clear(),this._states.clear(),this._values.clear(),this._descriptors=null,this._dirty=!0,this._mutable=!1}markDirty(){this._dirty=!0}markMutable(){this._dirty=!0,this._mutable=!0}getDescriptors(e){let t=this._descriptors;if(!t){t=e;for(let s of yt.keys())this._states.get(s)?.[0]===1&&(t===e&&(t=e.slice()),t.push(...Fm(s)));this._descriptors=t}return t}getUniformProperty(e){let t=LS.get(e);if(t===void 0||this._states.get(t)?.[0]!==1)return null;let s=Fm(t);return s[0].uniformName===e?s[0]:s[1]}write(e,t,s,r){let i=this._values.get(e),a=t*3;s[r]=i[a],s[r+1]=i[a+1],s[r+2]=i[a+2]}update(e){if(!this._dirty&&!this._mutable)return!1;this._dirty=!1;let t=!1,s=!1;for(let r of yt.keys()){let i=e[`_${r}Map`]?1:0,a=e[`_${r}MapUv`],o=e[`_${r}MapTiling`],n=e[`_${r}MapOffset`],c=e[`_${r}MapRotation`],h=this._states.get(r);if(h||(h=new Float64Array(7),h[0]=-1,this._states.set(r,h)),(h[0]!==i||i&&(h[1]!==a||h[2]!==o.x||h[3]!==o.y||h[4]!==n.x||h[5]!==n.y||h[6]!==c))&&(h[0]===1!=(i===1)&&(s=!0),h[0]=i,h[1]=a,h[2]=o.x,h[3]=o.y,h[4]=n.x,h[5]=n.y,h[6]=c,t=!0,i)){this._compute(r,o,n,c);let d=Fm(r);e._markPropertyModified(d[0]),e._markPropertyModified(d[1])}}return s&&(this._descriptors=null,e._markLayoutDirty()),t?this._updateIds():!1}collectUnapplied(e,t){if(!(!this._dirty&&!this._mutable))for(let s of yt.keys()){let r=this._states.get(s),i=e[`_${s}Map`]?1:0;if(!r||r[0]!==i)t.push(`${s}Map`);else if(i){r[1]!==e[`_${s}MapUv`]&&t.push(`${s}MapUv`);let a=e[`_${s}MapTiling`];(r[2]!==a.x||r[3]!==a.y)&&t.push(`${s}MapTiling`);let o=e[`_${s}MapOffset`];(r[4]!==o.x||r[5]!==o.y)&&t.push(`${s}MapOffset`),r[6]!==e[`_${s}MapRotation`]&&t.push(`${s}MapRotation`)}}}_compute(e,t,s,r){let i=this._values.get(e);i||(i=new Float32Array(6),this._values.set(e,i));let a=Math.cos(r*O.DEG_TO_RAD),o=Math.sin(r*O.DEG_TO_RAD);i[0]=a*t.x,i[1]=-o*t.y,i[2]=s.x,i[3]=o*t.x,i[4]=a*t.y,i[5]=1-t.y-s.y}_updateIds(){let e=[],t=this._ids,s=new Map,r=!1,i=1;for(let a of yt.keys()){let o=0,n=this._states.get(a),c=n[2]===1&&n[3]===1&&n[4]===0&&n[5]===0&&n[6]===0;if(n[0]===1&&!c){let h=this._values.get(a),d=n[1],f=e[d]??(e[d]=[]),u;for(let m=0;m<f.length;m++)if(gP(f[m].transform,h)){u=f[m];break}u?o=u.id:(o=i,f.push({id:o,transform:h}))}s.set(a,o),r||(r=(t.get(a)??0)!==o),i++}return this._ids=s,r}getId(e){return this._ids.get(e)??0}};var Ih=class l{static update(e,t,s,r,i,a,o){l.updateSharedOptions(e,t,s,i,a,r),l.updateMaterialOptions(e,t),l.updateEnvOptions(e,t,s,r),l.updateLightingOptions(e,t,s,i,o)}static updateSharedOptions(e,t,s,r,i,a){e.shaderChunks=t.shaderChunks,e.pass=i,e.linearDepth=i===ps||!!a?.sceneTextures.includes(Di),e.alphaTest=t.alphaTest>0,e.blendType=t.blendType,e.screenSpace=r&&(r&yi)!==0,e.skin=r&&(r&ar)!==0,e.useInstancing=r&&(r&us)!==0,e.useMorphPosition=r&&(r&or)!==0,e.useMorphNormal=r&&(r&nr)!==0,e.useMorphTextureBasedInt=r&&(r&lr)!==0,e.hasTangents=r&&(r&Ma)!==0,e.nineSlicedMode=t.nineSlicedMode||am,t.useLighting&&s.clusteredLightingEnabled?(e.clusteredLightingEnabled=!0,e.clusteredLightingCookiesEnabled=s.lighting.cookiesEnabled,e.clusteredLightingShadowsEnabled=s.lighting.shadowsEnabled,e.clusteredLightingShadowType=s.lighting.shadowType,e.clusteredLightingAreaLightsEnabled=s.lighting.areaLightsEnabled):(e.clusteredLightingEnabled=!1,e.clusteredLightingCookiesEnabled=!1,e.clusteredLightingShadowsEnabled=!1,e.clusteredLightingAreaLightsEnabled=!1)}static updateMaterialOptions(e,t){e.separateAmbient=!1,e.pixelSnap=t.pixelSnap,e.ambientSH=t.ambientSH,e.twoSidedLighting=t.twoSidedLighting,e.occludeDirect=t.occludeDirect,e.occludeSpecular=t.occludeSpecular,e.occludeSpecularFloat=t.occludeSpecularIntensity!==1,e.useMsdf=!1,e.msdfTextAttribute=!1,e.alphaToCoverage=t.alphaToCoverage,e.opacityFadesSpecular=t.opacityFadesSpecular,e.opacityDither=t.opacityDither,e.cubeMapProjection=Qo,e.useSpecular=t.hasSpecular,e.useSpecularityFactor=t.hasSpecularityFactor,e.enableGGXSpecular=t.ggxSpecular,e.useAnisotropy=!1,e.fresnelModel=t.fresnelModel,e.useRefraction=t.hasRefraction,e.useClearCoat=t.hasClearCoat,e.useSheen=t.hasSheen,e.useIridescence=t.hasIridescence,e.useMetalness=t.hasMetalness,e.useDynamicRefraction=t.dynamicRefraction,e.dispersion=t.dispersion>0,e.vertexColors=!1,e.lightMapEnabled=t.hasLighting,e.dirLightMapEnabled=t.dirLightMap,e.useHeights=t.hasHeights,e.useNormals=t.hasNormals,e.useClearCoatNormals=t.hasClearCoatNormals,e.useAo=t.hasAo,e.diffuseMapEnabled=t.hasDiffuseMap}static updateEnvOptions(e,t,s,r){e.fog=t.useFog?r.fog:Is,e.gamma=r.shaderOutputGamma,e.toneMap=t.useTonemap?r.toneMapping:Xr,t.useSkybox&&s.envAtlas&&s.skybox?(e.reflectionSource=Ia,e.reflectionEncoding=s.envAtlas.encoding,e.reflectionCubemapEncoding=s.skybox.encoding):t.useSkybox&&s.envAtlas?(e.reflectionSource=Da,e.reflectionEncoding=s.envAtlas.encoding):t.useSkybox&&s.skybox?(e.reflectionSource=wa,e.reflectionEncoding=s.skybox.encoding):(e.reflectionSource=es,e.reflectionEncoding=null),t.ambientSH?(e.ambientSource=en,e.ambientEncoding=null):e.reflectionSource!==es&&s.envAtlas?(e.ambientSource=tn,e.ambientEncoding=s.envAtlas.encoding):(e.ambientSource=sn,e.ambientEncoding=null);let i=e.reflectionSource!==es;e.skyboxIntensity=i,e.useCubeMapRotation=i&&s._skyboxRotationShaderInclude}static updateLightingOptions(e,t,s,r,i){if(e.lightMapWithoutAmbient=!1,t.useLighting){let a=r?r>>>cr:Tt;e.lightMaskDynamic=!!(a&Tt),e.lightMapWithoutAmbient=!1,e.lights=l.selectLights(i,a)}else e.lights=[];(e.lights.length===0&&!s.clusteredLightingEnabled||(r&Ei)!==0)&&(e.noShadow=!0)}static selectLights(e,t){let s=[];if(e){let r=e.slots;for(let i=0;i<r.length;i++){let a=r[i];a.mask&t&&(s[i]=a)}}return s}};var SP=l=>l.r!==0||l.g!==0||l.b!==0,Tn=class l{static DEFAULT_REFRACTION_INDEX=1/1.5;static equalish(e,t){return Math.abs(e-t)<1e-4}updateMinRef(e,t,s,r,i,a,o,n=!1){this._updateSharedOptions(e,t,s,r,i),this._updateMinOptions(e,s,i,n),this._updateUVOptions(e,s,r,o,!0)}updateRef(e,t,s,r,i,a,o,n){this._updateSharedOptions(e,t,r,i,a,s),this._updateEnvOptions(e,r,t,s),this._updateMaterialOptions(e,r,t),e.litOptions.hasTangents=i&&(i&Ma)!==0,this._updateLightOptions(e,t,r,i,o),this._updateUVOptions(e,r,i,n,!1,s)}_updateSharedOptions(e,t,s,r,i,a){e.forceUv1=s.forceUv1,e.litOptions.linearDepth=i===ps||!!a?.sceneTextures.includes(Di),s.userAttributes&&(e.litOptions.userAttributes=Object.fromEntries(s.userAttributes.entries())),e.litOptions.shaderChunks=s.shaderChunks,e.litOptions.pass=i,e.litOptions.alphaTest=s.alphaTest>0,e.litOptions.blendType=s.blendType,e.litOptions.screenSpace=r&&(r&yi)!==0,e.litOptions.skin=r&&(r&ar)!==0,e.litOptions.batch=r&&(r&Yr)!==0,e.litOptions.useInstancing=r&&(r&us)!==0,e.litOptions.useMorphPosition=r&&(r&or)!==0,e.litOptions.useMorphNormal=r&&(r&nr)!==0,e.litOptions.useMorphTextureBasedInt=r&&(r&lr)!==0,e.litOptions.nineSlicedMode=s.nineSlicedMode||0,t.clusteredLightingEnabled&&s.useLighting?(e.litOptions.clusteredLightingEnabled=!0,e.litOptions.clusteredLightingCookiesEnabled=t.lighting.cookiesEnabled,e.litOptions.clusteredLightingShadowsEnabled=t.lighting.shadowsEnabled,e.litOptions.clusteredLightingShadowType=t.lighting.shadowType,e.litOptions.clusteredLightingAreaLightsEnabled=t.lighting.areaLightsEnabled):(e.litOptions.clusteredLightingEnabled=!1,e.litOptions.clusteredLightingCookiesEnabled=!1,e.litOptions.clusteredLightingShadowsEnabled=!1,e.litOptions.clusteredLightingAreaLightsEnabled=!1)}_updateUVOptions(e,t,s,r,i,a){let o=(s&Yc)!==0;e.litOptions.vertexColors=!1;let n=t.textureIdentifiers;for(let c of yt.keys())this._updateTexOptions(e,t,c,r,o,i,n);e.litOptions.ssao=a?.ssaoEnabled,e.useAO=e.litOptions.ssao,e.litOptions.lightMapEnabled=e.lightMap||e.lightVertexColor,e.litOptions.dirLightMapEnabled=e.dirLightMap,e.litOptions.useHeights=e.heightMap,e.parallaxMode=e.heightMap?t.parallaxMode:xi,e.parallaxSelfShadow=e.parallaxMode===lm&&t.parallaxShadowSamples>0,e.litOptions.useNormals=e.normalMap,e.litOptions.useClearCoatNormals=e.clearCoatNormalMap,e.litOptions.useAo=e.aoMap||e.aoVertexColor||e.litOptions.ssao,e.litOptions.diffuseMapEnabled=e.diffuseMap}_updateTexOptions(e,t,s,r,i,a,o){let n=s==="opacity";if(!a||n){let c=`${s}Map`,h=`${s}VertexColor`,d=`${s}VertexColorChannel`,f=`${c}Channel`,u=`${c}Transform`,m=`${c}Uv`,_=`${c}Identifier`,p=s==="light"&&e.useInstanceLightMap;if(s!=="light"&&(e[c]=!1,e[_]=void 0,e[f]="",e[u]=0,e[m]=0),e[h]=!1,e[d]="",n&&t.blendType===tt&&t.alphaTest===0&&!t.alphaToCoverage&&t.opacityDither===Ut)return;s!=="height"&&t[h]&&i&&(e[h]=t[h],e[d]=t[d],e.litOptions.vertexColors=!0),!p&&t[c]&&r?.hasUv(t[m])&&(e[c]=!!t[c],e[_]=o.get(s)??s,e[u]=t._getMapTransformId(s),e[f]=t[f],e[m]=t[m])}}_updateMinOptions(e,t,s,r){let i=s===ps;e.litOptions.opacityShadowDither=i?t.opacityDither:t.opacityShadowDither,e.litOptions.lights=[],r&&(e.litOptions.blendType=tt,e.litOptions.clusteredLightingEnabled=!1,e.litOptions.clusteredLightingCookiesEnabled=!1,e.litOptions.clusteredLightingShadowsEnabled=!1,e.litOptions.clusteredLightingAreaLightsEnabled=!1)}_updateMaterialOptions(e,t,s){let r=!!(t.useMetalness||t.specularMap||t.sphereMap||t.cubeMap||SP(t.specular)||t.specularityFactor>0&&t.useMetalness||t.enableGGXSpecular||t.clearCoat>0),i=!t.useMetalness||t.useMetalnessSpecularColor,a=r&&t.useMetalnessSpecularColor&&(t.specularityFactorTint||t.specularityFactor!==1),o=h=>h?h.format===vo||h.type===Fo:!1,{equalish:n,DEFAULT_REFRACTION_INDEX:c}=l;e.specularityFactorTint=a,e.metalnessTint=t.useMetalness&&t.metalness<1,e.glossTint=!0,e.diffuseEncoding=t.diffuseMap?.encoding,e.diffuseDetailEncoding=t.diffuseDetailMap?.encoding,e.emissiveEncoding=t.emissiveMap?.encoding,e.lightMapEncoding=t.lightMap?.encoding,e.packedNormal=o(t.normalMap),e.refractionTint=!n(t.refraction,1),e.refractionIndexTint=!n(t.refractionIndex,c),e.thicknessTint=t.useDynamicRefraction&&t.thickness!==1,e.specularEncoding=t.specularMap?.encoding,e.sheenEncoding=t.sheenMap?.encoding,e.aoDetail=!!t.aoDetailMap,e.diffuseDetail=!!t.diffuseDetailMap,e.normalDetail=!!t.normalMap,e.normalDetailPackedNormal=o(t.normalDetailMap),e.diffuseDetailMode=t.diffuseDetailMode,e.aoDetailMode=t.aoDetailMode,e.clearCoatGloss=!!t.clearCoatGloss,e.clearCoatPackedNormal=o(t.clearCoatNormalMap),e.iorTint=!n(t.refractionIndex,c),e.iridescenceTint=t.iridescence!==1,e.glossInvert=t.glossInvert,e.sheenGlossInvert=t.sheenGlossInvert,e.clearCoatGlossInvert=t.clearCoatGlossInvert,e.useSpecularColor=i,e.litOptions.separateAmbient=!1,e.litOptions.pixelSnap=t.pixelSnap,e.litOptions.ambientSH=!!t.ambientSH,e.litOptions.twoSidedLighting=t.twoSidedLighting,e.litOptions.occludeSpecular=t.occludeSpecular,e.litOptions.occludeSpecularFloat=t.occludeSpecularIntensity!==1,e.litOptions.useMsdf=!!t.msdfMap,e.litOptions.msdfTextAttribute=!!t.msdfTextAttribute,e.litOptions.alphaToCoverage=t.alphaToCoverage,e.litOptions.opacityFadesSpecular=t.opacityFadesSpecular,e.litOptions.opacityDither=t.opacityDither,e.litOptions.cubeMapProjection=t.cubeMapProjection,e.litOptions.occludeDirect=t.occludeDirect,e.litOptions.useSpecular=r,e.litOptions.useSpecularityFactor=(a||!!t.specularityFactorMap)&&t.useMetalnessSpecularColor,e.litOptions.enableGGXSpecular=t.enableGGXSpecular,e.litOptions.useAnisotropy=t.enableGGXSpecular&&(t.anisotropyIntensity>0||!!t.anisotropyMap),e.litOptions.fresnelModel=t.fresnelModel,e.litOptions.useRefraction=(t.refraction||!!t.refractionMap)&&(t.useDynamicRefraction||e.litOptions.reflectionSource!==es),e.litOptions.useClearCoat=!!t.clearCoat,e.litOptions.useSheen=t.useSheen,e.litOptions.useIridescence=t.useIridescence&&t.iridescence!==0,e.litOptions.useMetalness=t.useMetalness,e.litOptions.useDynamicRefraction=t.useDynamicRefraction,e.litOptions.dispersion=t.dispersion>0,e.litOptions.shadowCatcher=t.shadowCatcher,e.litOptions.useVertexColorGamma=t.vertexColorGamma}_updateEnvOptions(e,t,s,r){e.litOptions.fog=t.useFog?r.fog:Is,e.litOptions.gamma=r.shaderOutputGamma,e.litOptions.toneMap=t.useTonemap?r.toneMapping:Xr;let i=t.useSkybox&&!t.envAtlas&&!t.cubeMap&&!t.sphereMap,a=!1;if(t.envAtlas&&t.cubeMap?(e.litOptions.reflectionSource=Ia,e.litOptions.reflectionEncoding=t.envAtlas.encoding,e.litOptions.reflectionCubemapEncoding=t.cubeMap.encoding):t.envAtlas?(e.litOptions.reflectionSource=Da,e.litOptions.reflectionEncoding=t.envAtlas.encoding):t.cubeMap?(e.litOptions.reflectionSource=wa,e.litOptions.reflectionEncoding=t.cubeMap.encoding):t.sphereMap?(e.litOptions.reflectionSource=sm,e.litOptions.reflectionEncoding=t.sphereMap.encoding):i&&s.envAtlas&&s.skybox?(e.litOptions.reflectionSource=Ia,e.litOptions.reflectionEncoding=s.envAtlas.encoding,e.litOptions.reflectionCubemapEncoding=s.skybox.encoding,a=!0):i&&s.envAtlas?(e.litOptions.reflectionSource=Da,e.litOptions.reflectionEncoding=s.envAtlas.encoding,a=!0):i&&s.skybox?(e.litOptions.reflectionSource=wa,e.litOptions.reflectionEncoding=s.skybox.encoding,a=!0):(e.litOptions.reflectionSource=es,e.litOptions.reflectionEncoding=null),t.ambientSH)e.litOptions.ambientSource=en,e.litOptions.ambientEncoding=null;else{let o=t.envAtlas||(i?s.envAtlas:null);o?(e.litOptions.ambientSource=tn,e.litOptions.ambientEncoding=o.encoding):(e.litOptions.ambientSource=sn,e.litOptions.ambientEncoding=null)}e.litOptions.skyboxIntensity=a,e.litOptions.useCubeMapRotation=a&&s._skyboxRotationShaderInclude,e.litOptions.useSceneEnv=a}_updateLightOptions(e,t,s,r,i){if(e.lightMap=!1,e.lightMapChannel="",e.lightMapUv=0,e.lightMapTransform=0,e.lightMapIdentifier=void 0,e.useInstanceLightMap=!1,e.litOptions.lightMapWithoutAmbient=!1,e.dirLightMap=!1,r&&(e.litOptions.noShadow=(r&Ei)!==0,(r&jc)!==0&&(e.lightMapEncoding=t.lightmapPixelFormat===Re?"rgbm":"linear",e.lightMap=!0,e.lightMapChannel="rgb",e.lightMapUv=1,e.lightMapTransform=0,e.useInstanceLightMap=!0,(r&qc)!==0&&(e.dirLightMap=!0),e.litOptions.lightMapWithoutAmbient=(r&$c)===0)),s.useLighting){let a=r?r>>>cr:Tt;e.litOptions.lightMaskDynamic=!!(a&Tt),e.litOptions.lights=Ih.selectLights(i,a)}else e.litOptions.lights=[];e.litOptions.lights.length===0&&!t.clusteredLightingEnabled&&(e.litOptions.noShadow=!0)}};function Ge(l,e=!0,t=!0){let s={};return s[`${l}Map`]="texture",s[`${l}MapTiling`]="vec2",s[`${l}MapOffset`]="vec2",s[`${l}MapRotation`]="number",s[`${l}MapUv`]="number",e&&(s[`${l}MapChannel`]="string",t&&(s[`${l}VertexColor`]="boolean",s[`${l}VertexColorChannel`]="string")),s}var wh={name:"string",chunks:"chunks",mappingFormat:"string",_engine:"boolean",ambient:"rgb",...Ge("ao"),...Ge("aoDetail",!0,!1),aoDetailMode:"string",aoIntensity:"number",diffuse:"rgb",...Ge("diffuse"),...Ge("diffuseDetail",!0,!1),diffuseDetailMode:"string",vertexColorGamma:"boolean",specular:"rgb",...Ge("specular"),occludeSpecular:"enum:occludeSpecular",specularityFactor:"number",specularityFactorTint:"boolean",...Ge("specularityFactor"),useMetalness:"boolean",metalness:"number",enableGGXSpecular:"boolean",metalnessTint:"boolean",...Ge("metalness"),useMetalnessSpecularColor:"boolean",anisotropyIntensity:"number",anisotropyRotation:"number",...Ge("anisotropy"),shininess:"number",gloss:"number",glossInvert:"boolean",...Ge("gloss"),clearCoat:"number",...Ge("clearCoat"),clearCoatGloss:"number",clearCoatGlossInvert:"boolean",...Ge("clearCoatGloss"),clearCoatBumpiness:"number",...Ge("clearCoatNormal",!1),useSheen:"boolean",sheen:"rgb",...Ge("sheen"),sheenGloss:"number",sheenGlossInvert:"boolean",...Ge("sheenGloss"),fresnelModel:"number",emissive:"rgb",...Ge("emissive"),emissiveIntensity:"number",...Ge("normal",!1),bumpiness:"number",...Ge("normalDetail",!1),normalDetailMapBumpiness:"number",...Ge("height",!0,!1),heightMapFactor:"number",heightMapBase:"number",parallaxMode:"string",parallaxSamples:"number",parallaxShadowSamples:"number",alphaToCoverage:"boolean",alphaTest:"number",alphaFade:"number",alphaDither:"number",opacity:"number",...Ge("opacity"),opacityFadesSpecular:"boolean",opacityDither:"string",opacityShadowDither:"string",reflectivity:"number",refraction:"number",refractionTint:"boolean",...Ge("refraction"),refractionIndex:"number",dispersion:"number",thickness:"number",thicknessTint:"boolean",...Ge("thickness"),attenuation:"rgb",attenuationDistance:"number",useDynamicRefraction:"boolean",sphereMap:"texture",cubeMap:"cubemap",cubeMapProjection:"number",cubeMapProjectionBox:"boundingbox",useIridescence:"boolean",iridescence:"number",iridescenceTint:"boolean",...Ge("iridescence"),iridescenceThicknessTint:"boolean",iridescenceThicknessMin:"number",iridescenceThicknessMax:"number",iridescenceRefractionIndex:"number",...Ge("iridescenceThickness"),...Ge("light"),depthTest:"boolean",depthFunc:"enum:depthFunc",depthWrite:"boolean",depthBias:"number",slopeDepthBias:"number",cull:"enum:cull",blendType:"enum:blendType",useFog:"boolean",useLighting:"boolean",useSkybox:"boolean",useTonemap:"boolean",envAtlas:"texture",twoSidedLighting:"boolean",flatShading:"boolean",shadowCatcher:"boolean"},En=[];for(let l in wh)wh[l]==="texture"&&En.push(l);var Om=[];for(let l in wh)wh[l]==="cubemap"&&Om.push(l);var Cn={},yn=new Set,TP=(l,e,t)=>{let s=l*O.DEG_TO_RAD;e[t]=Math.cos(s),e[t+1]=Math.sin(s)},EP=(l,e,t)=>{e[t]=l===0?0:1/l},yP=(l,e,t)=>{e[t]=l*.1},CP=(l,e,t,s)=>{let r=s._opacity;e[t]=r>0?(l??r)/r:1},vP=(l,e,t)=>{let s=l?l.getMin():y.ZERO;e[t]=s.x,e[t+1]=s.y,e[t+2]=s.z},xP=(l,e,t)=>{let s=l?l.getMax():y.ZERO;e[t]=s.x,e[t+1]=s.y,e[t+2]=s.z},$={diffuse:new Q("diffuse","material_diffuse",Z,Mi),emissive:new Q("emissive","material_emissive",Z,Mi),emissiveIntensity:new Q("emissiveIntensity","material_emissiveIntensity",b,we),ambient:new Q("ambient","material_ambient",Z,Mi),specular:new Q("specular","material_specular",Z,Mi),sheen:new Q("sheen","material_sheen",Z,Mi),attenuation:new Q("attenuation","material_attenuation",Z,Mi),specularityFactor:new Q("specularityFactor","material_specularityFactor",b,we),sheenGloss:new Q("sheenGloss","material_sheenGloss",b,we),gloss:new Q("gloss","material_gloss",b,we),aoIntensity:new Q("aoIntensity","material_aoIntensity",b,we),heightMapBase:new Q("heightMapBase","material_heightMapBase",b,we),parallaxSamples:new Q("parallaxSamples","material_parallaxSamples",b,we),parallaxShadowSamples:new Q("parallaxShadowSamples","material_parallaxShadowSamples",b,we),opacity:new Q("opacity","material_opacity",b,we),alphaFade:new Q("alphaFade","material_alphaFade",b,we),bumpiness:new Q("bumpiness","material_bumpiness",b,we),normalDetailMapBumpiness:new Q("normalDetailMapBumpiness","material_normalDetailMapBumpiness",b,we),reflectivity:new Q("reflectivity","material_reflectivity",b,we),occludeSpecularIntensity:new Q("occludeSpecularIntensity","material_occludeSpecularIntensity",b,we),refraction:new Q("refraction","material_refraction",b,we),refractionIndex:new Q("refractionIndex","material_refractionIndex",b,we),dispersion:new Q("dispersion","material_dispersion",b,we),thickness:new Q("thickness","material_thickness",b,we),metalness:new Q("metalness","material_metalness",b,we),anisotropyIntensity:new Q("anisotropyIntensity","material_anisotropyIntensity",b,we),clearCoat:new Q("clearCoat","material_clearCoat",b,we),clearCoatGloss:new Q("clearCoatGloss","material_clearCoatGloss",b,we),clearCoatBumpiness:new Q("clearCoatBumpiness","material_clearCoatBumpiness",b,we),iridescence:new Q("iridescence","material_iridescence",b,we),iridescenceRefractionIndex:new Q("iridescenceRefractionIndex","material_iridescenceRefractionIndex",b,we),iridescenceThicknessMin:new Q("iridescenceThicknessMin","material_iridescenceThicknessMin",b,we),iridescenceThicknessMax:new Q("iridescenceThicknessMax","material_iridescenceThicknessMax",b,we),anisotropyRotation:new Q("anisotropyRotation","material_anisotropyRotation",ht,TP),attenuationDistance:new Q("attenuationDistance","material_invAttenuationDistance",b,EP),heightMapFactor:new Q("heightMapFactor","material_heightMapFactor",b,yP),alphaDither:new Q("alphaDither","material_alphaDitherScale",b,CP),envBoxMin:new Q("cubeMapProjectionBox","envBoxMin",Z,vP),envBoxMax:new Q("cubeMapProjectionBox","envBoxMax",Z,xP)},bS=[$.envBoxMin,$.envBoxMax],Bm=Object.values($),AP=new Map(Bm.map(l=>[l.uniformName,l])),FS=l=>l.r===0&&l.g===0&&l.b===0,Fe=(l,e)=>l===0||l===1||e===0||e===1,{equalish:Mh,DEFAULT_REFRACTION_INDEX:Um}=Tn,ur=class extends Os{_usesViewTextures=!0;static TEXTURE_PARAMETERS=En;static CUBEMAP_PARAMETERS=Om;userAttributes=new Map;_specularIsBlack;_textureSharing="";_sharingCheckedVersion=-1;_mapTransforms=new Dh;onUpdateShader;constructor(){super(),this._assetReferences={},this._activeParams=new Set,this.shaderOptBuilder=new Tn,this.reset(),this._specularIsBlack=FS(this._specular)}reset(){Object.keys(Cn).forEach(e=>{this[`_${e}`]=Cn[e].value()}),this._mutableProperties?.clear();for(let e of Bm)this._markPropertyModified(e);this._mapTransforms.reset(),this._markLayoutDirty()}get propertyDescriptors(){return this._mapTransforms.getDescriptors(Bm)}get textureDescriptors(){return wS(this)}get textureIdentifiers(){return Ph(this)}getUniformBufferProperty(e){return AP.get(e)??this._mapTransforms.getUniformProperty(e)}_collectUnappliedChanges(e){this._mapTransforms.collectUnapplied(this,e)}set diffuse(e){this._diffuse.equals(e)||(this._diffuse.copy(e),this._markPropertyModified($.diffuse))}get diffuse(){return this._markPropertyMutable($.diffuse,this._diffuse),this._diffuse}set emissive(e){this._emissive.equals(e)||(this._emissive.copy(e),this._markPropertyModified($.emissive))}get emissive(){return this._markPropertyMutable($.emissive,this._emissive),this._emissive}set emissiveIntensity(e){this._emissiveIntensity!==e&&(this._emissiveIntensity=e,this._markPropertyModified($.emissiveIntensity))}get emissiveIntensity(){return this._emissiveIntensity}set ambient(e){this._ambient.equals(e)||(this._ambient.copy(e),this._markPropertyModified($.ambient))}get ambient(){return this._markPropertyMutable($.ambient,this._ambient),this._ambient}set specular(e){this._specular.equals(e)||(this._specular.copy(e),this._markPropertyModified($.specular))}get specular(){return this._markPropertyMutable($.specular,this._specular),this._specular}set sheen(e){this._sheen.equals(e)||(this._sheen.copy(e),this._markPropertyModified($.sheen))}get sheen(){return this._markPropertyMutable($.sheen,this._sheen),this._sheen}set attenuation(e){this._attenuation.equals(e)||(this._attenuation.copy(e),this._markPropertyModified($.attenuation))}get attenuation(){return this._markPropertyMutable($.attenuation,this._attenuation),this._attenuation}set specularityFactor(e){this._specularityFactor!==e&&(this._dirtyShader=this._dirtyShader||Fe(this._specularityFactor,e),this._specularityFactor=e,this._markPropertyModified($.specularityFactor))}get specularityFactor(){return this._specularityFactor}set sheenGloss(e){this._sheenGloss!==e&&(this._dirtyShader=this._dirtyShader||Fe(this._sheenGloss,e),this._sheenGloss=e,this._markPropertyModified($.sheenGloss))}get sheenGloss(){return this._sheenGloss}set gloss(e){this._gloss!==e&&(this._dirtyShader=this._dirtyShader||Fe(this._gloss,e),this._gloss=e,this._markPropertyModified($.gloss))}get gloss(){return this._gloss}set aoIntensity(e){this._aoIntensity!==e&&(this._dirtyShader=this._dirtyShader||Fe(this._aoIntensity,e),this._aoIntensity=e,this._markPropertyModified($.aoIntensity))}get aoIntensity(){return this._aoIntensity}set heightMapBase(e){this._heightMapBase!==e&&(this._heightMapBase=e,this._markPropertyModified($.heightMapBase))}get heightMapBase(){return this._heightMapBase}set parallaxSamples(e){this._parallaxSamples!==e&&(this._dirtyShader=this._dirtyShader||Fe(this._parallaxSamples,e),this._parallaxSamples=e,this._markPropertyModified($.parallaxSamples))}get parallaxSamples(){return this._parallaxSamples}set parallaxShadowSamples(e){this._parallaxShadowSamples!==e&&(this._dirtyShader=this._dirtyShader||this._parallaxShadowSamples===0!=(e===0),this._parallaxShadowSamples=e,this._markPropertyModified($.parallaxShadowSamples))}get parallaxShadowSamples(){return this._parallaxShadowSamples}set opacity(e){this._opacity!==e&&(this._dirtyShader=this._dirtyShader||Fe(this._opacity,e),this._opacity=e,this._markPropertyModified($.opacity),this._markPropertyModified($.alphaDither))}get opacity(){return this._opacity}set alphaFade(e){this._alphaFade!==e&&(this._dirtyShader=this._dirtyShader||Fe(this._alphaFade,e),this._alphaFade=e,this._markPropertyModified($.alphaFade))}get alphaFade(){return this._alphaFade}set bumpiness(e){this._bumpiness!==e&&(this._dirtyShader=this._dirtyShader||Fe(this._bumpiness,e),this._bumpiness=e,this._markPropertyModified($.bumpiness))}get bumpiness(){return this._bumpiness}set normalDetailMapBumpiness(e){this._normalDetailMapBumpiness!==e&&(this._dirtyShader=this._dirtyShader||Fe(this._normalDetailMapBumpiness,e),this._normalDetailMapBumpiness=e,this._markPropertyModified($.normalDetailMapBumpiness))}get normalDetailMapBumpiness(){return this._normalDetailMapBumpiness}set reflectivity(e){this._reflectivity!==e&&(this._dirtyShader=this._dirtyShader||Fe(this._reflectivity,e),this._reflectivity=e,this._markPropertyModified($.reflectivity))}get reflectivity(){return this._reflectivity}set occludeSpecularIntensity(e){this._occludeSpecularIntensity!==e&&(this._dirtyShader=this._dirtyShader||Fe(this._occludeSpecularIntensity,e),this._occludeSpecularIntensity=e,this._markPropertyModified($.occludeSpecularIntensity))}get occludeSpecularIntensity(){return this._occludeSpecularIntensity}set refraction(e){this._refraction!==e&&(this._dirtyShader=this._dirtyShader||Fe(this._refraction,e)||Mh(this._refraction,1)!==Mh(e,1),this._refraction=e,this._markPropertyModified($.refraction))}get refraction(){return this._refraction}set refractionIndex(e){this._refractionIndex!==e&&(this._dirtyShader=this._dirtyShader||Mh(this._refractionIndex,Um)!==Mh(e,Um),this._refractionIndex=e,this._markPropertyModified($.refractionIndex))}get refractionIndex(){return this._refractionIndex}set dispersion(e){this._dispersion!==e&&(this._dirtyShader=this._dirtyShader||Fe(this._dispersion,e),this._dispersion=e,this._markPropertyModified($.dispersion))}get dispersion(){return this._dispersion}set thickness(e){this._thickness!==e&&(this._dirtyShader=this._dirtyShader||Fe(this._thickness,e),this._thickness=e,this._markPropertyModified($.thickness))}get thickness(){return this._thickness}set metalness(e){this._metalness!==e&&(this._dirtyShader=this._dirtyShader||Fe(this._metalness,e),this._metalness=e,this._markPropertyModified($.metalness))}get metalness(){return this._metalness}set anisotropyIntensity(e){this._anisotropyIntensity!==e&&(this._dirtyShader=this._dirtyShader||Fe(this._anisotropyIntensity,e),this._anisotropyIntensity=e,this._markPropertyModified($.anisotropyIntensity))}get anisotropyIntensity(){return this._anisotropyIntensity}set clearCoat(e){this._clearCoat!==e&&(this._dirtyShader=this._dirtyShader||Fe(this._clearCoat,e),this._clearCoat=e,this._markPropertyModified($.clearCoat))}get clearCoat(){return this._clearCoat}set clearCoatGloss(e){this._clearCoatGloss!==e&&(this._dirtyShader=this._dirtyShader||Fe(this._clearCoatGloss,e),this._clearCoatGloss=e,this._markPropertyModified($.clearCoatGloss))}get clearCoatGloss(){return this._clearCoatGloss}set clearCoatBumpiness(e){this._clearCoatBumpiness!==e&&(this._dirtyShader=this._dirtyShader||Fe(this._clearCoatBumpiness,e),this._clearCoatBumpiness=e,this._markPropertyModified($.clearCoatBumpiness))}get clearCoatBumpiness(){return this._clearCoatBumpiness}set iridescence(e){this._iridescence!==e&&(this._dirtyShader=this._dirtyShader||Fe(this._iridescence,e),this._iridescence=e,this._markPropertyModified($.iridescence))}get iridescence(){return this._iridescence}set iridescenceRefractionIndex(e){this._iridescenceRefractionIndex!==e&&(this._dirtyShader=this._dirtyShader||Fe(this._iridescenceRefractionIndex,e),this._iridescenceRefractionIndex=e,this._markPropertyModified($.iridescenceRefractionIndex))}get iridescenceRefractionIndex(){return this._iridescenceRefractionIndex}set iridescenceThicknessMin(e){this._iridescenceThicknessMin!==e&&(this._dirtyShader=this._dirtyShader||Fe(this._iridescenceThicknessMin,e),this._iridescenceThicknessMin=e,this._markPropertyModified($.iridescenceThicknessMin))}get iridescenceThicknessMin(){return this._iridescenceThicknessMin}set iridescenceThicknessMax(e){this._iridescenceThicknessMax!==e&&(this._dirtyShader=this._dirtyShader||Fe(this._iridescenceThicknessMax,e),this._iridescenceThicknessMax=e,this._markPropertyModified($.iridescenceThicknessMax))}get iridescenceThicknessMax(){return this._iridescenceThicknessMax}set anisotropyRotation(e){this._anisotropyRotation!==e&&(this._dirtyShader=this._dirtyShader||Fe(this._anisotropyRotation,e),this._anisotropyRotation=e,this._markPropertyModified($.anisotropyRotation))}get anisotropyRotation(){return this._anisotropyRotation}set attenuationDistance(e){this._attenuationDistance!==e&&(this._dirtyShader=this._dirtyShader||Fe(this._attenuationDistance,e),this._attenuationDistance=e,this._markPropertyModified($.attenuationDistance))}get attenuationDistance(){return this._attenuationDistance}set heightMapFactor(e){this._heightMapFactor!==e&&(this._dirtyShader=this._dirtyShader||Fe(this._heightMapFactor,e),this._heightMapFactor=e,this._markPropertyModified($.heightMapFactor))}get heightMapFactor(){return this._heightMapFactor}set alphaDither(e){this._alphaDither!==e&&(this._alphaDither=e,this._markPropertyModified($.alphaDither))}get alphaDither(){return this._alphaDither??this._opacity}set cubeMapProjectionBox(e){let t=this._cubeMapProjectionBox;if(e)if(t){if(t.equals(e))return;t.copy(e)}else this._cubeMapProjectionBox=e.clone();else{if(!t)return;this._cubeMapProjectionBox=null}for(let s of bS)this._markPropertyModified(s),e||this._mutableProperties?.delete(s)}get cubeMapProjectionBox(){let e=this._cubeMapProjectionBox;if(e)for(let t of bS)this._markPropertyMutable(t,e);return e}set alphaTest(e){let t=this._alphaTest;t!==e&&(this._dirtyShader=this._dirtyShader||t>0!=e>0||t===0!=(e===0),this._alphaTest=e)}get alphaTest(){return this._alphaTest}copy(e){return super.copy(e),Object.keys(Cn).forEach(t=>{this[t]=Cn[t].copyFromBacking?e[`_${t}`]:e[t]}),this._alphaDither=e._alphaDither,this.userAttributes=new Map(e.userAttributes),this}update(){this._mapTransforms.update(this)&&(this._dirtyShader=!0);let e=FS(this._specular);if(this._specularIsBlack!==e&&(this._specularIsBlack=e,this._dirtyShader=!0),this._sharingCheckedVersion!==this._textureAssignmentVersion){this._sharingCheckedVersion=this._textureAssignmentVersion;let t=IS(this);this._textureSharing!==t&&(this._textureSharing=t,this._dirtyShader=!0)}super.update()}_getMapTransformId(e){return this._mapTransforms.getId(e)}setAttribute(e,t){this.userAttributes.set(t,e)}_setParameter(e,t){yn.add(e),this.setParameter(e,t)}_processParameters(){let e=this._activeParams;e.forEach(t=>{yn.has(t)||delete this.parameters[t]}),this._activeParams=yn,yn=e,yn.clear()}_updateMap(e){let t=`${e}Map`,s=this[t];s&&this._setParameter(`texture_${t}`,s)}updateUniforms(e,t){this._mapTransforms.update(this)&&(this._dirtyShader=!0);for(let s of yt.keys())this._updateMap(s);this.ambientSH&&this._setParameter("ambientSH[0]",this.ambientSH),this.envAtlas&&this.cubeMap?(this._setParameter("texture_envAtlas",this.envAtlas),this._setParameter("texture_cubeMap",this.cubeMap)):this.envAtlas?this._setParameter("texture_envAtlas",this.envAtlas):this.cubeMap?this._setParameter("texture_cubeMap",this.cubeMap):this.sphereMap&&this._setParameter("texture_sphereMap",this.sphereMap),this._processParameters(),super.updateUniforms(e,t)}getShaderVariant(e){let{device:t,scene:s,pass:r,objDefs:i,lightList:a,cameraShaderParams:o,vertexFormat:n}=e,c=at.get(t).getByIndex(r),h=c.defines.has("PCOUTLINE_PASS"),d=r===vi||r===ps||c.isShadow||h,f=d?xh.optionsContextMin:xh.optionsContext;f.defines=ot.getCoreDefines(this,e),d?this.shaderOptBuilder.updateMinRef(f,s,this,i,r,a,n,h):this.shaderOptBuilder.updateRef(f,s,o,this,i,r,a,n);let u=c.isForward&&this.blendState.usesDualSourceBlending;f.useDualSourceBlending=u,this.useFog||f.defines.set("FOG","NONE"),f.defines.set("TONEMAP",Xc[h?Xr:f.litOptions.toneMap]),this.onUpdateShader&&(f=this.onUpdateShader(f)),f.useDualSourceBlending=u;let m=new $r(e.viewUniformFormat,e.vertexFormat,cS(e.viewUniformFormat)),_=Ah(t,this.propertyDescriptors,this.getTextureDescriptors(t));m.uniformFormats[er]=_.uniformBufferFormat,m.bindGroupFormats[er]=_.bindGroupFormat;let p=hr(t);return p.register("standard",xh),p.getProgram("standard",f,m,this.userId)}destroy(){for(let e in this._assetReferences)this._assetReferences[e]._unbind();this._assetReferences=null,super.destroy()}set shininess(e){Object.assign(this,{gloss:e*.01})}get shininess(){return this.gloss*100}set useGammaTonemap(e){Object.assign(this,{useTonemap:e})}get useGammaTonemap(){return this.useTonemap}set anisotropy(e){Object.assign(this,{anisotropyIntensity:Math.abs(e),anisotropyRotation:e>=0?0:90})}get anisotropy(){let e=Math.sign(Math.cos(this.anisotropyRotation*O.DEG_TO_RAD*2));return this.anisotropyIntensity*e}},ie=(l,e,t=!1)=>{Cn[l]={value:e,copyFromBacking:t}},km=(l,e,t,s,r=!1)=>{Object.defineProperty(ur.prototype,l,{get:s||function(){return this[`_${l}`]},set:t}),ie(l,e,r)},RP=l=>{let e=`_${l.name}`,t=l.dirtyShaderFunc||(()=>!0),s=l.onGet,r=l.onSet,i=function(o){let n=this[e];n!==o&&(this._dirtyShader=this._dirtyShader||t(n,o),this[e]=o,r?.call(this))},a=l.getterFunc||s&&function(){return s.call(this),this[e]};km(l.name,()=>l.defaultValue,i,a,!!s)},PP=l=>{let e=`_${l.name}`,t=l.dirtyShaderFunc||(()=>!0),s=l.onGet,r=l.onSet,i=function(o){let n=this[e];n.equals(o)||(this._dirtyShader=this._dirtyShader||t(n,o),this[e]=n.copy(o),r?.call(this))},a=l.getterFunc||s&&function(){return s.call(this),this[e]};km(l.name,()=>l.defaultValue.clone(),i,a,!!s)},Ns=l=>l.defaultValue&&l.defaultValue.clone?PP(l):RP(l),Lh=function(){this._mapTransforms.markDirty()},DP=function(){this._mapTransforms.markDirty(),this._textureAssignmentVersion++},OS=function(){this._mapTransforms.markMutable()};function Ne(l,e="rgb",t=!0,s=0){yt.set(l,e.length||-1),Ns({name:`${l}Map`,defaultValue:null,dirtyShaderFunc:(r,i)=>!!r!=!!i||r&&(r.type!==i.type||r.format!==i.format),onSet:DP}),Ns({name:`${l}MapTiling`,defaultValue:new k(1,1),dirtyShaderFunc:()=>!1,onSet:Lh,onGet:OS}),Ns({name:`${l}MapOffset`,defaultValue:new k(0,0),dirtyShaderFunc:()=>!1,onSet:Lh,onGet:OS}),Ns({name:`${l}MapRotation`,defaultValue:0,dirtyShaderFunc:()=>!1,onSet:Lh}),Ns({name:`${l}MapUv`,defaultValue:s,onSet:Lh}),e&&(Ns({name:`${l}MapChannel`,defaultValue:e}),t&&(Ns({name:`${l}VertexColor`,defaultValue:!1}),Ns({name:`${l}VertexColorChannel`,defaultValue:e})))}var IP=(l,e)=>!!l!=!!e,Nm=(l,e)=>!!l!=!!e||!!l&&!!e&&l.encoding!==e.encoding;function bh(l,e=IP){Ns({name:l,defaultValue:null,dirtyShaderFunc:e})}function ye(l,e){Ns({name:l,defaultValue:e})}function wP(){ie("diffuse",()=>new z(1,1,1),!0),ie("emissive",()=>new z(0,0,0),!0),ie("emissiveIntensity",()=>1),ie("ambient",()=>new z(1,1,1),!0),ie("specular",()=>new z(0,0,0),!0),ie("sheen",()=>new z(1,1,1),!0),ie("attenuation",()=>new z(1,1,1),!0),ie("specularityFactor",()=>1),ie("sheenGloss",()=>0),ie("gloss",()=>.25),ie("aoIntensity",()=>1),ie("heightMapBase",()=>.5),ie("parallaxSamples",()=>16),ie("parallaxShadowSamples",()=>0),ie("opacity",()=>1),ie("alphaFade",()=>1),ie("bumpiness",()=>1),ie("normalDetailMapBumpiness",()=>1),ie("reflectivity",()=>1),ie("occludeSpecularIntensity",()=>1),ie("refraction",()=>0),ie("refractionIndex",()=>Um),ie("dispersion",()=>0),ie("thickness",()=>0),ie("metalness",()=>1),ie("anisotropyIntensity",()=>0),ie("clearCoat",()=>0),ie("clearCoatGloss",()=>1),ie("clearCoatBumpiness",()=>1),ie("iridescence",()=>0),ie("iridescenceRefractionIndex",()=>1/1.5),ie("iridescenceThicknessMin",()=>0),ie("iridescenceThicknessMax",()=>0),ie("anisotropyRotation",()=>0),ie("attenuationDistance",()=>0),ie("heightMapFactor",()=>1),ie("alphaDither",()=>null),ie("cubeMapProjectionBox",()=>null,!0),ie("alphaTest",()=>0),bh("ambientSH"),ye("specularityFactorTint",!1),ye("useMetalness",!1),ye("useMetalnessSpecularColor",!1),ye("useSheen",!1),ye("enableGGXSpecular",!1),ye("occludeDirect",!1),ye("opacityFadesSpecular",!0),ye("occludeSpecular",tm),ye("fresnelModel",$o),ye("useDynamicRefraction",!1),ye("cubeMapProjection",Qo),ye("useFog",!0),ye("useLighting",!0),ye("useTonemap",!0),ye("useSkybox",!0),ye("forceUv1",!1),ye("pixelSnap",!1),ye("twoSidedLighting",!1),ye("nineSlicedMode",void 0),ye("msdfTextAttribute",!1),ye("useIridescence",!1),ye("glossInvert",!1),ye("sheenGlossInvert",!1),ye("clearCoatGlossInvert",!1),ye("parallaxMode",xi),ye("opacityDither",Ut),ye("opacityShadowDither",Ut),ye("shadowCatcher",!1),ye("vertexColorGamma",!1),Ne("diffuse"),Ne("specular"),Ne("emissive"),Ne("thickness","g"),Ne("specularityFactor","g"),Ne("normal",""),Ne("metalness","g"),Ne("gloss","g"),Ne("opacity","a"),Ne("refraction","g"),Ne("height","g",!1),Ne("ao","g"),Ne("light","rgb",!0,1),Ne("msdf",""),Ne("diffuseDetail","rgb",!1),Ne("normalDetail",""),Ne("aoDetail","g",!1),Ne("clearCoat","g"),Ne("clearCoatGloss","g"),Ne("clearCoatNormal",""),Ne("sheen","rgb"),Ne("sheenGloss","g"),Ne("iridescence","g"),Ne("iridescenceThickness","g"),Ne("anisotropy",""),ye("diffuseDetailMode",em),ye("aoDetailMode",em),bh("cubeMap",Nm),bh("sphereMap",Nm),bh("envAtlas",Nm);let l=function(){return this._prefilteredCubemaps},e=function(s){let r=this._prefilteredCubemaps;s=s||[];let i=!1,a=!0;for(let o=0;o<6;++o){let n=s[o]||null;r[o]!==n&&(r[o]=n,i=!0),a=a&&!!r[o]}i&&(a?this.envAtlas=Wa.generatePrefilteredAtlas(r,{target:this.envAtlas}):this.envAtlas&&(this.envAtlas.destroy(),this.envAtlas=null),this._dirtyShader=!0)},t=[null,null,null,null,null,null];km("prefilteredCubemaps",()=>t.slice(),e,l)}wP();function _s(l,e){Object.defineProperty(ur.prototype,e,{get:function(){return this[l]},set:function(t){this[l]=t}})}function vn(l){Object.defineProperty(ur.prototype,l,{get:function(){return!0},set:function(e){}})}vn("sheenTint");vn("diffuseTint");vn("emissiveTint");vn("ambientTint");vn("specularTint");_s("aoVertexColor","aoMapVertexColor");_s("diffuseVertexColor","diffuseMapVertexColor");_s("specularVertexColor","specularMapVertexColor");_s("emissiveVertexColor","emissiveMapVertexColor");_s("metalnessVertexColor","metalnessMapVertexColor");_s("glossVertexColor","glossMapVertexColor");_s("opacityVertexColor","opacityMapVertexColor");_s("lightVertexColor","lightMapVertexColor");_s("aoMapUv","aoUvSet");_s("sheenGloss","sheenGlossiness");_s("clearCoatGloss","clearCoatGlossiness");var Fh=class{gridPositions=[];gridColors=[];mesh=null;meshInstance=null;_pendingMeshInstance=null;_layer=null;colorLow=new y(1,1,1);colorHigh=new y(40,0,0);frameUpdate(){this._pendingMeshInstance=null,this._layer=null}onPreRenderLayer(e,t){this._pendingMeshInstance&&e===this._layer&&(t.push(this._pendingMeshInstance),this._pendingMeshInstance=null,this._layer=null)}render(e,t){this.frameUpdate();let s=t.device,r=e.cells,i=e.lightsBuffer,a=i.boundsMin,o=i.boundsDelta,n=a.clone().add(o),c=i.boundsDelta.clone().div(r),h=this.gridPositions,d=this.gridColors,f=new z(.3,.3,.3),u=(w,M,P,L,G,U,F,Y,K)=>{for(let W=0;W<=w;W++)for(let ae=0;ae<=M;ae++){let H=P+W*L,ee=G+ae*U;K===0?h.push(H,F,ee,H,Y,ee):K===1?h.push(H,ee,F,H,ee,Y):K===2&&h.push(F,H,ee,Y,H,ee)}};if(u(r.x,r.z,a.x,c.x,a.z,c.z,a.y,n.y,0),u(r.x,r.y,a.x,c.x,a.y,c.y,a.z,n.z,1),u(r.y,r.z,a.y,c.y,a.z,c.z,a.x,n.x,2),h.length){let w=h.length/3;if(w!==d.length/4){d.length=0;for(let M=0;M<w;M++)d.push(f.r,f.g,f.b,f.a)}t.drawLineArrays(h,d),h.length=0}let m=this.mesh;m||(m=new ts(s),m.clear(!0,!0),this.mesh=m);let _=[],p=[],g=[],T=e._cells.x,S=e._cells.z,x=e.counts,C=e._maxCellLightCount,E=new y,v=new y,A=new y,D=o.clone().div(r),R=0;for(let w=0;w<r.x;w++)for(let M=0;M<r.z;M++)for(let P=0;P<r.y;P++){let L=w+T*(M+P*S),G=x[L];if(G>0){E.x=a.x+D.x*w,E.y=a.y+D.y*P,E.z=a.z+D.z*M,v.add2(E,D),_.push(E.x,E.y,v.z),_.push(v.x,E.y,v.z),_.push(v.x,v.y,v.z),_.push(E.x,v.y,v.z),_.push(v.x,E.y,E.z),_.push(E.x,E.y,E.z),_.push(E.x,v.y,E.z),_.push(v.x,v.y,E.z),A.lerp(this.colorLow,this.colorHigh,G/C).round();for(let U=0;U<8;U++)p.push(A.x,A.y,A.z,1);g.push(R*8+0,R*8+1,R*8+3),g.push(R*8+3,R*8+1,R*8+2),g.push(R*8+4,R*8+5,R*8+7),g.push(R*8+7,R*8+5,R*8+6),g.push(R*8+3,R*8+2,R*8+6),g.push(R*8+2,R*8+7,R*8+6),g.push(R*8+1,R*8+0,R*8+4),g.push(R*8+0,R*8+5,R*8+4),g.push(R*8+1,R*8+4,R*8+2),g.push(R*8+4,R*8+7,R*8+2),g.push(R*8+5,R*8+0,R*8+6),g.push(R*8+0,R*8+3,R*8+6),R++}}if(R){if(m.setPositions(_),m.setNormals(new Float32Array(_.length)),m.setColors32(p),m.setIndices(g),m.update($s,!1),!this.meshInstance){let w=new ur;w.useLighting=!1,w.emissive=new z(1,1,1),w.emissiveVertexColor=!0,w.blendType=qo,w.depthWrite=!1,w.update();let M=new wt("WorldClustersDebug");this.meshInstance=new nt(m,w,M),this.meshInstance.cull=!1,this.meshInstance.castShadow=!1}this._pendingMeshInstance=this.meshInstance,this._layer=t.defaultDrawLayer}}destroy(){if(this.frameUpdate(),this.meshInstance){let e=this.meshInstance.material;this.meshInstance.destroy(),e.destroy(),this.meshInstance=null}else this.mesh?.destroy();this.mesh=null}};var MP="muPIHORMLNDCz4DxVR/ZvYfAUVEFR47KRIC4nwAAAAAP7WxlhD6Ci+2HCe7BF8jRAPZwdH2UPpI5PdLCJdkvG4UTaNDJ/0crAzne71GCrb4kbdMjjCEGzdX6fNxDMLJq5xkeoIVTdfiZkodEeArmZmp/FQzFjD4x8iOW7Dg64n+3mWqyEwLxXT8zoJXfbw8QJKDCaarUYyTlMzNFHbgUe9IQV7g4YOgtSKpIFZJ0qERm7u4PpmiF89ktHWCywaGmD6h+hfh2/Zd8KYlKqqo4Cem4T42bT/Z9FpCQF1hhSjfBzZ5XFn/y3jegWC6u86KuELRundQS/1Rp+XuKKGIgRv3CvP5y749yqLlFO495JOT3+f2CXgd71npU0/KjjpkZucbJ5m78IVyuSrSozc9jgBUhDrz0hFsyb7LFUH9//wJbBgLdNWJZObfKxrNt8TliLA9w9sXFv6g26iXpf6r/BqcAusj/QzGBZuoUGeEtw8BCXCZ3jUiw4hvM18ZVqlUD3C40LAFXW6FRjuAZGRNstb0/qVk4skwyT+MHrvRorI4rKHVMWZmKyAkzL/78u/9pMQuX14pZN50b2PHn6fRxeaCQLsfT4dpvIkWWFuFVENZIh+8xgR6lU+85W0PPdAu1j99kcCG40JBQa4JMyRzq6qriOBLtqF87vpCJan0WEduVr/mOYkS00urVA0mA6M3031+GmGmW48PaJDYOEIb3bIXWPaLoAOEinX1TN3+/vwhG6nqJu0TdHpedS7QsGZIoxH3nQYYjQP1jmbahlbNngw5ogsGk1y50XZyUmQBY+/JBJ3Unu4dApm+WmPwHPU9gLb+4mHh4BiY6M86pq+WeTyWdI3s0CXPEtHGXZ8zMZgUoyRomBi1VdazzuN+WOmQ9Pa0Z0tlNopUi8AJ4x2Xn4mmOKEbXLxlbVsWu8XhuDGYFOGCRVdSqDPXrHU5SDdUlti3k5///SBwzTMwK3L4a1H7w4lnpEas6////AfX8asyIBfeFXVJ3tgvxQ/blZuUKyIODIfr/UzdWNu7pciLBpdZRZ4pIfZ1R6szq+XNxkGG///8EZFpu7VHAhFWqHEOrB9unw+YQa5o8/9IR/V5/zq+986rJSyfgJKt2u9hxU1wzyQWPjJGvzG9+eWWxGFOHVKqI4jBQALwZZswesnvZ2UmmkEXdiRpz8B+oWE7PY70ZTMndisYSXg2TqoI+3y9BxbnY2Y4EfbdcRhAvG59NqDENNYbxKvK5HJfPG5M+Wi2AcpLVJrD6caiEOzgSoVNSgQK8fm2M3zGcF4xtClv/8Hs9oD7C3jitTATYNQxmKqKf1LhIxzf1bmfiNn7UKFmcJu4sLqVLwxGSue3taBEyknkw5hXTsUCvqmmL/f8n/w0giR7Hu/9EHvpkz3yuu64TioMkzdTJ30i0+hFnQqW1+v9mMwq+z9qGX0UFu9MomvVG2xod6vc12AAAAACq7sGa5qptFR0jF3nQt/D+7PibKYahaxP3hEixPbGi9nwNf2LAa7LkEZRKxzXeCD64Xpii5n+8Kpg8eHIv7AWXZltgMoGltmoJ0XGdOCL8WkzphvR9N2o3ARSZ42l5e5Pe4B58MCRlP3EKv+mcloknH+fto5BWsmEutW6KvjOVsznFCktkSczVk4aGvj9VXlRcLeDoKG8RkBgdcNG2bf8HUL4MT2DM+ar7NImJhKpxakX4Vk0CnP+/XNhl5UsP0lXgeZXPoDBMSW5An+DXlTCO5FQGwSPYwHLKYVIimEdAoVe49rQLaaNcye5LxU2/c5TijTgJtD5eQQIe1snxauj5jZsxJBUJdoP/zqpjqv8qBruoPsVsP8N44PCUW5Dd0DzqjSS/Dl5mI9cn1w2ndN/0KAEm1QAAAACwu6KM/083IBbH5bPa/9oHUwcU8I9v3j6/v18QYammrf+P6VL///8BrpuM3fOLCxaLNOFNF1zPbPYTP65ni6njft4eVcyrVXRQFrs52tr35StiSp55edVDCBC0H5rIfac6nzUwxQSt7y15QoKb+5zebEQUmVbrPjXuUa19Ey7sqXMiSUKHaw72PJKDdrutJoQr3u6lEYJ8K0MakWKj9zjTFi4X94TsKYco0GrLeB60M6D8M/80rhXUW8iMequg8y5F838WI0+gp3GBN5Kj/xIOxTWQuUaPV/LwvARr1VH93BFgGZR1MFW0Ua30GbYmdnAgo9VWy8SQtpDUgGE2r2zq2eTEMCL7sMKmE1hchVhuF/TCq9iXKEm86kzOf3Rp9ZnCxbpDUj+FKNxVyXe6pVZkRXv/m95SnB/EB8aME29N85MtAcDoXWlor8De2Q5Dg1tar+8wgiZufbMam81j//ASUohoR/zSh2KG4bvT6mkIPz6C5/98DC3LaWlaEZ1zA5JORZRu6J/a0GY285sEYzw71YqOT1ihAG0z5SDt1xNiDQWZdFpndArp6xWhqSDkRb4kSJEHb9liPvw7uLV/6i5MVf//A9Qjr8xkAEUh+KDI+zdtJ68d6MBOktg1iyp/SCq8O9f5pbamn1VVVQPRTWqNBvhQKa07s6P0lc9Luu/3gw4HeyOUfz8MxMwV4UQhua+t9cr4bz/nIB2wnDSK1K7I94M+s6C84htaX/CNlMQUSs2KJO+yaebfTbkNX5yWcqEJevo0vbKUiETuFXiL019A3E+lmsyZMwXrXLLiQAZ5t9+jI3JobhJTMiDH5ZOQ+8Jau5555NMjHSscP9qCVaa40doh+1a3Ukf6jqBmLddgh79/fwTfCyqiuldNkUoy+nUp+4nerwg0OjtGv2x485PJOJvUEokNhYIdWjpx7BWk0VZGWOp3jSFTJ2bnu6KCduZtG/UcBC9RZ3W/jMSfSMw4Etr/DoD/XYP2V5Ovw+YoM3F5g2dGLdvuG6ZkVGLE6Dk5Zr+sdSyGliJP1y2OFf/KFO0RWO+3gsGhesTnfZVpTd8/HwgO216gwaqo+vY3TljfJWowY+i0p0Os4SLn/1wLqDHMlszggmT/D8MRFzs+pLv6LNJSsNZ/r41mWi/rF6ZcKp/yzJdK0VU44hskq3RGpgO6mIpJDsf/mZkFrz0yYOMLbuaj/wp1v7JMFM5eqvBhmTd7U8frQAtHtys4zgpjZmzUhOVTfNNLifElGXADlqHGKrkBT/nYwX8ZRm3RjvyPvjKyEqEGKUpVnvOGx+NKPHiWM//ZDpDVGvvrjmk8RPF/wiYZD3+Us8YCXjrVOfjdd1UPAfjLp8jgSn4me7DPTpz1Ggy9XL80guFO7ECT10AvILKfD18Qx+KY/f8aRqu0oOO8hfKRFZa9PUJwCsp6VdZz6LFkm2b9Pl2LIifCwzRy7TpdG2uAtOxP2OemY26bJMa9ZGSLIRlMsgpDpnDJwd0oa5pQ13x1hrHf52HpulUWonGWsfXZbSQYKu9bnEN76ciQih0opN3deDVrbrxorfVlnCmL1R9zq3ePGWIv21c7pW8kEiFTM5JX8dAw867s/60cf79/BH+MDFCZBHlz1L+qGOJf/1txhhmrf3//As+RIJwevDb+fgNXVeHw67QptZegayhrEwr5Gy+EPo1RLaMtPbqOZYoVzXzwzjMFWZxyUG9YUIf6////AQWy84iAygLk9COtXt92+0mT/xg0zMzMBeLkb8y9SL2TDXgSX422hDgpGNLJyuPioA+YJ91G8znrpNqHkwYyscaJDEc9Vc+j4cXle3hvcd2JqDQH2lBZxDn6mUTs0b75raMvbs727codX01Anj8f3wir9P2xQaQ22v/TxCMglKDFoTjaP01XTLgxnTvPv02JgEUrW6UDgOnobFpLdvKdlypgIzPcq14fgXU5tvVW0FEs7VRlsG1IyA69fN4n+awHhT34cE+xUvdj86C8LgAsFheTjI9Ht9EyYAAAAAAVBVKRx2wLgUTI0/2QfyJo2riRw3JDqzEShmx/Lifo6mRkQVbS7X53t+EvKxcXogtdts31e9MRHdcHgsA8rt4/mt2unlzQ/wsU8Gu7+W6Oj7eD8EQdDp5XlCsVaS/AV/t5ZpPOHR3rGpyAJe9IPV+xMrBL1Oz/8MQhFs31h0N1cVnq371uqIJYHyafKH1jteAK3VpMXBcuC+yt0ZeKyRUY4QhdrJJ4tJ1wg3Hu6kDsbovxupTMkGdRrm8oZSoYPbJ+PwH/xotgTdkA1205vUEfnqkI04T/fnnd1fiZW5AwNcggd7fi4j5zasmcntZexIxqFZQMzMJpfndmI5jn17cgn5EV5t9XN0C///8Q9wlJpMGXdoiaMTG2sVyHQsn8mWRISCLNG777S0OuDRP2GlLcJ2UeOg7Fo8hTNPeJ//iTJhyqxhKRUntdXOihq2wfKfH///8B0GGrwT+fSOQRdctKxjjGCSS11d6BlQ9BDfE0J6Z25FaNTKGpFKNCMr2G/041KpWwBLVe1k08vncseQbKZdXi8x1t9XA45U/Wd43D9wAh3Tal0aiLVzGPusOZ1F+W3TWoqlX/A95+dNef11TsuGful+ctGssldk3fqpfqh+43XTxL42+leSHoF/dWHYGX6maqUEuLX7UB+r/6Llr4LKocbVIeu+hB9QTPfz9fCP8RyWmX4SmbhMFsNtCijV7lVcwejLKlvl0GfCndnWV7/39VBrtTRuUx92oke3GBgKkC5fdGK0YvNK+xenKaDmsHDjNFUM3NMz3ZiXXFuLgojosPVCDEl2W5BjX3Ms+j0GSqACHmh0+RPWyuNm/Qe8vFf9AW7N1uRaxWirrUytqEJnJ4/Flm8hSoiZ2NQBsS6w/yQlC4gCaFo8q4nyY6AFdo4hiwhBXzbNKKvZvktCjSCukRR/BbYVbNwZi2Yh3hGodEacLW8qijiWJODf0P2bhfaiPspPT4lYJBgi/KfcFwCfvyUIgkJOv///8CG/JEepRBLaMFE+2TgrqsJXOVOWHt6g/bFwVLLMVBsMR50dis/39/AlBX+/rMTJkUQrnlxpR2iu0Tp8tATkRYGmDIrcAiRP8PjoWIlb7/0ecTdSCE9Y58+a+n/FovJQTVF4F2jAxMZhTgrM/KVS5BQu6bVbkWY5HXnxRshks3urDdW4RkWp4M4TeLmFK5KF/uHkkiO5Kv96RioH984v/CSDBnG+BwlnU9B+o7Y+0X0Nob+0pLsStxjvPXMy2eCpzhOWV4XbObBHN4UE2sLQ/DIqXhOzxVf38GlTi6aG7EnePO7TRJm9yOfUUcqq1I2iQHrVDqn3TUNRi/lMw8KbMW/3/nqCz/Ef8PoW5Qxcz2yHR/f78EPB2Stbd+ZFmfNTUYILzsb9YNhpaHcaymYrBiNHmFE3Y4ccYJ25Prqm7zHobGHED8/93ZNlWro9vcKivGZs31UiK1k5zjUhexUgbqJb+fUTjxce/7Zly8a5KMC1fX5nfjPgibdvzbXV1jRT2asXvmSAusaLdq1TSIJ8fXINk5AtT34EWPAsfP9IFQqM5K11O6saoHJA==",mr=null,NS=()=>{if(!mr){let l=atob(MP);mr=Uint8Array.from(l,e=>e.charCodeAt(0))}},BS=()=>(NS(),mr),Oh=class{seed=0;constructor(e=0){this.seed=e*4,NS()}_next(){this.seed=(this.seed+4)%mr.length}value(){return this._next(),mr[this.seed]/255}vec4(e=new ne){return this._next(),e.set(mr[this.seed],mr[this.seed+1],mr[this.seed+2],mr[this.seed+3]).mulScalar(1/255)}};var LP=[new y(-1,0,0),new y(1,0,0),new y(0,-1,0),new y(0,1,0),new y(0,0,-1),new y(0,0,1)],Nh=class{colors=new Float32Array(18);update(e,t){let s=this.colors,{r,g:i,b:a}=e;for(let o=0;o<6;o++)s[o*3]=r,s[o*3+1]=i,s[o*3+2]=a;for(let o=0;o<t.length;o++){let n=t[o];if(n._type===te)for(let c=0;c<6;c++){let h=Math.max(LP[c].dot(n._direction),0)*n._intensity,d=n._color;s[c*3]+=d.r*h,s[c*3+1]+=d.g*h,s[c*3+2]+=d.b*h}}}};var bP=(l,e,t,s)=>{let r=new se(l,{name:`${e}${t}`,width:t,height:t,format:Re,addressU:0,addressV:0,type:At,magFilter:0,minFilter:0,anisotropy:1,mipmaps:!1});return r.lock().set(s),r.unlock(),r},FP=new Se,US=l=>FP.get(l,()=>{let e=BS(),t=Math.sqrt(e.length/4);return bP(l,"BlueNoise",t,e)});var OP=new y(-.5,0,0),NP=new y(0,0,.5),kS=new y,Bh=class{constructor(e,t){let s=e.scope,r=`light${t}_`;this.slot=t,this._paletteName=`${r}shadowMatrixPalette`,this.color=s.resolve(`${r}color`),this.direction=s.resolve(`${r}direction`),this.position=s.resolve(`${r}position`),this.radius=s.resolve(`${r}radius`),this.innerConeAngle=s.resolve(`${r}innerConeAngle`),this.outerConeAngle=s.resolve(`${r}outerConeAngle`),this.halfWidth=s.resolve(`${r}halfWidth`),this.halfHeight=s.resolve(`${r}halfHeight`),this.shadowMap=s.resolve(`${r}shadowMap`),this.shadowMatrix=s.resolve(`${r}shadowMatrix`),this.shadowParams=s.resolve(`${r}shadowParams`),this.shadowIntensity=s.resolve(`${r}shadowIntensity`),this.shadowSearchArea=s.resolve(`${r}shadowSearchArea`),this.cameraParams=s.resolve(`${r}cameraParams`),this.softShadowParams=s.resolve(`${r}softShadowParams`),this.shadowMatrixPalette=s.resolve(`${this._paletteName}[0]`),this.shadowCascadeDistances=s.resolve(`${r}shadowCascadeDistances`),this.shadowCascadeCount=s.resolve(`${r}shadowCascadeCount`),this.shadowCascadeBlend=s.resolve(`${r}shadowCascadeBlend`),this.shadowCascadeParams=s.resolve(`${r}shadowCascadeParams`),this.cookie=s.resolve(`${r}cookie`),this.cookieIntensity=s.resolve(`${r}cookieIntensity`),this.cookieMatrix=s.resolve(`${r}cookieMatrix`),this.cookieOffset=s.resolve(`${r}cookieOffset`),this._direction=new Float32Array(3),this._position=new Float32Array(3),this._halfWidth=new Float32Array(3),this._halfHeight=new Float32Array(3)}appendFormats(e,t){let s=t._type,r=(a,o)=>e.push(new I(a.name,o));r(this.color,Z),s===te?r(this.direction,Z):(r(this.position,Z),r(this.radius,b),s===Ue&&(r(this.direction,Z),r(this.innerConeAngle,b),r(this.outerConeAngle,b))),t._shape!==Qt&&(s===te&&r(this.position,Z),r(this.halfWidth,Z),r(this.halfHeight,Z));let i=t.castShadows;i&&(s!==ze&&r(this.shadowMatrix,Be),r(this.shadowIntensity,b),r(this.shadowParams,Pe),t._isPcss&&(r(this.shadowSearchArea,b),r(this.cameraParams,Pe),s===te&&(r(this.softShadowParams,Pe),r(this.shadowCascadeParams,Be))),s===te&&(e.push(new I(this._paletteName,Be,4)),r(this.shadowCascadeDistances,Pe),r(this.shadowCascadeCount,ct),r(this.shadowCascadeBlend,b))),t._cookie&&(s===ze?(r(this.cookieIntensity,b),r(this.shadowMatrix,Be)):s===Ue&&(r(this.cookieIntensity,b),i||r(this.shadowMatrix,Be),t._cookieTransform&&(r(this.cookieMatrix,Pe),r(this.cookieOffset,ht))))}dispatch(e,t){switch(e._type){case te:this._dispatchDirectional(e,t);break;case ze:this._dispatchOmni(e);break;case Ue:this._dispatchSpot(e);break}}_dispatchDirectional(e,t){let s=e._node.getWorldTransform();if(this.color.setValue(e._colorLinear),s.getY(e._direction).mulScalar(-1),e._direction.normalize(),this._setDirection(e._direction),e.shape!==Qt&&this._setLtcDirectional(s,e._direction,t._node.getPosition(),t.farClip),e.castShadows){let r=e.getRenderData(t,0),i=e._getUniformBiasValues(r);if(this.shadowMap.setValue(r.shadowBuffer),this.shadowMatrix.setValue(r.shadowMatrix.data),this.shadowMatrixPalette.setValue(e._shadowMatrixPalette),this.shadowCascadeDistances.setValue(e._shadowCascadeDistances),this.shadowCascadeCount.setValue(e.numCascades),this.shadowCascadeBlend.setValue(1-e.cascadeBlend),this.shadowIntensity.setValue(e.shadowIntensity),e._isPcss){this.softShadowParams.setValue(e._softShadowParams),r.shadowCamera.renderTarget&&this.shadowSearchArea.setValue(e.penumbraSize/r.shadowCamera.renderTarget.width*r.projectionCompensation);let n=e._shadowCameraParams;n.length=4,n[0]=r.projectionCompensation,n[1]=r.shadowCamera._farClip,n[2]=r.shadowCamera._nearClip,n[3]=1,this.cameraParams.setValue(n);let c=e._shadowCascadeParams??(e._shadowCascadeParams=new Float32Array(16));for(let h=0;h<4;h++){let d=h<e.numCascades?e.getRenderData(t,h):null,f=d?.projectionCompensation>0?d:r,u=f.shadowCamera,m=h*4;c[m]=f.projectionCompensation,c[m+1]=u._farClip,c[m+2]=u._nearClip,c[m+3]=1}this.shadowCascadeParams.setValue(c)}let a=e._shadowRenderParams;a.length=4,a[0]=e._shadowResolution,a[1]=i.normalBias,a[2]=i.bias,a[3]=0,this.shadowParams.setValue(a)}}_dispatchOmni(e){let t=e._node.getWorldTransform();if(this.radius.setValue(e.attenuationEnd),this.color.setValue(e._colorLinear),t.getTranslation(e._position),this._setPosition(e._position),e.shape!==Qt&&this._setLtcPositional(t),e.castShadows){let s=e.getRenderData(null,0);this.shadowMap.setValue(s.shadowBuffer);let r=e._getUniformBiasValues(s),i=e._shadowRenderParams;i.length=4,i[0]=e._shadowResolution,i[1]=r.normalBias,i[2]=r.bias,i[3]=1/e.attenuationEnd,this.shadowParams.setValue(i),this.shadowIntensity.setValue(e.shadowIntensity);let a=e.penumbraSize/s.shadowCamera.renderTarget.width;this.shadowSearchArea.setValue(a);let o=e._shadowCameraParams;o.length=4,o[0]=0,o[1]=s.shadowCamera._farClip,o[2]=s.shadowCamera._nearClip,o[3]=0,this.cameraParams.setValue(o)}e._cookie&&(this.cookie.setValue(e._cookie),this.shadowMatrix.setValue(t.data),this.cookieIntensity.setValue(e.cookieIntensity))}_dispatchSpot(e){let t=e._node.getWorldTransform();if(this.innerConeAngle.setValue(e._innerConeAngleCos),this.outerConeAngle.setValue(e._outerConeAngleCos),this.radius.setValue(e.attenuationEnd),this.color.setValue(e._colorLinear),t.getTranslation(e._position),this._setPosition(e._position),e.shape!==Qt&&this._setLtcPositional(t),t.getY(e._direction).mulScalar(-1),e._direction.normalize(),this._setDirection(e._direction),e.castShadows){let s=e.getRenderData(null,0);this.shadowMap.setValue(s.shadowBuffer),this.shadowMatrix.setValue(s.shadowMatrix.data);let r=e._getUniformBiasValues(s),i=e._shadowRenderParams;i.length=4,i[0]=e._shadowResolution,i[1]=r.normalBias,i[2]=r.bias,i[3]=1/e.attenuationEnd,this.shadowParams.setValue(i),this.shadowIntensity.setValue(e.shadowIntensity);let a=e.penumbraSize/s.shadowCamera.renderTarget.width,o=s.shadowCamera._fov*O.DEG_TO_RAD,n=1/Math.tan(o/2);this.shadowSearchArea.setValue(a*n);let c=e._shadowCameraParams;c.length=4,c[0]=0,c[1]=s.shadowCamera._farClip,c[2]=s.shadowCamera._nearClip,c[3]=0,this.cameraParams.setValue(c)}if(e._cookie){if(!e.castShadows){let s=bs.evalSpotCookieMatrix(e);this.shadowMatrix.setValue(s.data)}this.cookie.setValue(e._cookie),this.cookieIntensity.setValue(e.cookieIntensity),e._cookieTransform&&(e._cookieTransformUniform[0]=e._cookieTransform.x,e._cookieTransformUniform[1]=e._cookieTransform.y,e._cookieTransformUniform[2]=e._cookieTransform.z,e._cookieTransformUniform[3]=e._cookieTransform.w,this.cookieMatrix.setValue(e._cookieTransformUniform),e._cookieOffsetUniform[0]=e._cookieOffset.x,e._cookieOffsetUniform[1]=e._cookieOffset.y,this.cookieOffset.setValue(e._cookieOffsetUniform))}}_setDirection(e){let t=this._direction;t[0]=e.x,t[1]=e.y,t[2]=e.z,this.direction.setValue(t)}_setPosition(e){let t=this._position;t[0]=e.x,t[1]=e.y,t[2]=e.z,this.position.setValue(t)}_setLtcDirectional(e,t,s,r){let i=this._position;i[0]=s.x-t.x*r,i[1]=s.y-t.y*r,i[2]=s.z-t.z*r,this.position.setValue(i),this._setLtcExtents(e,r)}_setLtcPositional(e){this._setLtcExtents(e,1)}_setLtcExtents(e,t){let s=e.transformVector(OP,kS),r=this._halfWidth;r[0]=s.x*t,r[1]=s.y*t,r[2]=s.z*t,this.halfWidth.setValue(r);let i=e.transformVector(NP,kS),a=this._halfHeight;a[0]=i.x*t,a[1]=i.y*t,a[2]=i.z*t,this.halfHeight.setValue(a)}};var Bs=class l{constructor(e,t){this.texture=e,this.cached=!1,this.renderTargets=t}destroy(){this.texture&&(this.texture.destroy(),this.texture=null);let e=this.renderTargets;for(let t=0;t<e.length;t++)e[t].destroy();this.renderTargets.length=0}static create(e,t){let s=null;return t._type===ze?s=this.createCubemap(e,t._shadowResolution,t._shadowType):s=this.create2dMap(e,t._shadowResolution,t._shadowType),s}static createAtlas(e,t,s){let r=this.create2dMap(e,t,s),i=r.renderTargets,a=i[0];for(let o=0;o<5;o++)i.push(a);return r}static create2dMap(e,t,s){let r=Jt.get(s),i=r.format;i===lt&&!e.textureFloatRenderable&&e.textureHalfFloatRenderable&&(i=xr);let a=rt.get(i)?.name,o=1;s===Ju&&(o=e.textureFloatFilterable?1:0),s===Wc&&(o=0);let n=new se(e,{format:i,width:t,height:t,mipmaps:!1,minFilter:o,magFilter:o,addressU:1,addressV:1,name:`ShadowMap2D_${a}`}),c=null;return r?.pcf?(n.compareOnRead=!0,n.compareFunc=1,c=new Le({depthBuffer:n,origin:pt})):c=new Le({colorBuffer:n,depth:!0,origin:pt}),new l(n,[c])}static createCubemap(e,t,s){let r=Jt.get(s),i=rt.get(r.format)?.name,a=s===Wc,o=a?0:1,n=new se(e,{format:r?.format,width:t,height:t,cubemap:!0,mipmaps:!1,minFilter:o,magFilter:o,addressU:1,addressV:1,name:`ShadowMapCube_${i}`});a||(n.compareOnRead=!0,n.compareFunc=1);let c=[];for(let h=0;h<6;h++)a?c.push(new Le({colorBuffer:n,face:h,depth:!0})):c.push(new Le({depthBuffer:n,face:h}));return new l(n,c)}};var BP=[],UP=[],pr=new ne,Gm=new ne,xn=class{constructor(e){this.size=Math.floor(e.w*1024),this.used=!1,this.lightId=-1,this.rect=e}},Uh=class{constructor(e){this.device=e,this.version=1,this.shadowAtlasResolution=2048,this.shadowAtlas=null,this.shadowEdgePixels=3,this.cookieAtlasResolution=4,this.cookieAtlas=se.createDataTexture2D(this.device,"CookieAtlas",this.cookieAtlasResolution,this.cookieAtlasResolution,vr),this.cookieRenderTarget=new Le({colorBuffer:this.cookieAtlas,depth:!1,origin:pt}),this.slots=[],this.atlasSplit=[],this.cubeSlotsOffsets=[new k(0,0),new k(0,1),new k(1,0),new k(1,1),new k(2,0),new k(2,1)],this.scissorVec=new ne,this.allocateShadowAtlas(1),this.allocateCookieAtlas(1),this.allocateUniforms()}destroy(){this.destroyShadowAtlas(),this.destroyCookieAtlas()}destroyShadowAtlas(){this.shadowAtlas?.destroy(),this.shadowAtlas=null}destroyCookieAtlas(){this.cookieAtlas?.destroy(),this.cookieAtlas=null,this.cookieRenderTarget?.destroy(),this.cookieRenderTarget=null}allocateShadowAtlas(e,t=Ko){let s=this.shadowAtlas?.texture.format,r=Jt.get(t).format;if(!this.shadowAtlas||this.shadowAtlas.texture.width!==e||s!==r){this.version++,this.destroyShadowAtlas(),this.shadowAtlas=Bs.createAtlas(this.device,e,t),this.shadowAtlas.cached=!0;let i=4/this.shadowAtlasResolution;this.scissorVec.set(i,i,-2*i,-2*i)}}allocateCookieAtlas(e){this.cookieAtlas.width!==e&&(this.cookieRenderTarget.resize(e,e),this.version++)}allocateUniforms(){this._shadowAtlasTextureId=this.device.scope.resolve("shadowAtlasTexture"),this._shadowAtlasParamsId=this.device.scope.resolve("shadowAtlasParams"),this._shadowAtlasParams=new Float32Array(2),this._cookieAtlasTextureId=this.device.scope.resolve("cookieAtlasTexture")}updateUniforms(){let t=this.shadowAtlas.renderTargets[0].depthBuffer;this._shadowAtlasTextureId.setValue(t),this._shadowAtlasParams[0]=this.shadowAtlasResolution,this._shadowAtlasParams[1]=this.shadowEdgePixels,this._shadowAtlasParamsId.setValue(this._shadowAtlasParams),this._cookieAtlasTextureId.setValue(this.cookieAtlas)}subdivide(e,t){let s=t.atlasSplit;if(!s){let i=Math.ceil(Math.sqrt(e));s=UP,s[0]=i,s.length=1}if(!((i,a)=>i.length===a.length&&i.every((o,n)=>o===a[n]))(s,this.atlasSplit)){this.version++,this.slots.length=0,this.atlasSplit.length=0,this.atlasSplit.push(...s);let i=this.atlasSplit[0];if(i>1){let a=1/i;for(let o=0;o<i;o++)for(let n=0;n<i;n++){let c=new ne(o*a,n*a,a,a),h=this.atlasSplit[1+o*i+n];if(h>1)for(let d=0;d<h;d++)for(let f=0;f<h;f++){let u=a/h,m=new ne(c.x+d*u,c.y+f*u,u,u);this.slots.push(new xn(m))}else this.slots.push(new xn(c))}}else this.slots.push(new xn(new ne(0,0,1,1)));this.slots.sort((a,o)=>o.size-a.size)}}collectLights(e,t){let s=t.cookiesEnabled,r=t.shadowsEnabled,i=!1,a=!1,o=BP;return o.length=0,(s||r)&&(c=>{for(let h=0;h<c.length;h++){let d=c[h];if(d.visibleThisFrame){let f=r&&d.castShadows,u=s&&!!d.cookie;i||(i=f),a||(a=u),(f||u)&&o.push(d)}}})(e),o.sort((c,h)=>h.maxScreenSize-c.maxScreenSize),i&&this.allocateShadowAtlas(this.shadowAtlasResolution,t.shadowType),a&&this.allocateCookieAtlas(this.cookieAtlasResolution),(i||a)&&this.subdivide(o.length,t),o}setupSlot(e,t){e.atlasViewport.copy(t);let s=e.numShadowFaces;for(let r=0;r<s;r++)if(e.castShadows||e._cookie){if(pr.copy(t),Gm.copy(t),e._type===Ue&&pr.add(this.scissorVec),e._type===ze){let i=pr.z/3,a=this.cubeSlotsOffsets[r];pr.x+=i*a.x,pr.y+=i*a.y,pr.z=i,pr.w=i,Gm.copy(pr)}if(e.castShadows){let i=e.getRenderData(null,r);i.shadowViewport.copy(pr),i.shadowScissor.copy(Gm)}}}assignSlot(e,t,s){e.atlasViewportAllocated=!0;let r=this.slots[t];r.lightId=e.id,r.used=!0,s&&(e.atlasSlotUpdated=!0,e.atlasVersion=this.version,e.atlasSlotIndex=t)}update(e,t){this.shadowAtlasResolution=t.shadowAtlasResolution,this.cookieAtlasResolution=t.cookieAtlasResolution;let s=this.collectLights(e,t);if(s.length>0){let r=this.slots;for(let o=0;o<r.length;o++)r[o].used=!1;let i=Math.min(s.length,r.length);for(let o=0;o<i;o++){let n=s[o];n.castShadows&&(n._shadowMap=this.shadowAtlas);let c=r[n.atlasSlotIndex];if(n.atlasVersion===this.version&&n.id===c?.lightId){let h=r[n.atlasSlotIndex];h.size===r[o].size&&!h.used&&this.assignSlot(n,n.atlasSlotIndex,!1)}}let a=0;for(let o=0;o<i;o++){for(;a<r.length&&r[a].used;)a++;let n=s[o];n.atlasViewportAllocated||this.assignSlot(n,a,!0);let c=r[n.atlasSlotIndex];this.setupSlot(n,c.rect)}}this.updateUniforms()}};var kh=class{constructor(){this.cache=new Map}destroy(){this.clear(),this.cache=null}clear(){this.cache.forEach(e=>{e.forEach(t=>{t.destroy()})}),this.cache.clear()}getKey(e){let t=e._type===ze,s=e._shadowType,r=e._shadowResolution;return`${t}-${s}-${r}`}get(e,t){let s=this.getKey(t),r=this.cache.get(s);if(r&&r.length)return r.pop();let i=Bs.create(e,t);return i.cached=!0,i}add(e,t){let s=this.getKey(e),r=this.cache.get(s);r?r.push(t):this.cache.set(s,[t])}};var Gh=class extends ft{constructor(e,t,s,r,i){super(e),this.requiresCubemaps=!1,this.shadowRenderer=t,this.light=s,this.face=r,this.applyVsm=i,this.shadowCamera=t.prepareFace(s,null,r),t.setupRenderPass(this,this.shadowCamera,!0)}frameUpdate(){super.frameUpdate(),this.enabled&&this.executeEnabled&&this.shadowRenderer.renderer.culler.requestLocalShadowCull(this.light)}execute(){this.shadowRenderer.renderFace(this.light,null,this.face,!1)}after(){this.executeEnabled&&this.applyVsm&&this.shadowRenderer.renderVsm(this.light,this.shadowCamera)}};var Vh=class{shadowLights=[];renderer;shadowRenderer;device;constructor(e,t){this.renderer=e,this.shadowRenderer=t,this.device=e.device}prepareShadowMap(e){!this.renderer.scene.clusteredLightingEnabled&&!e._shadowMap&&(e._shadowMap=Bs.create(this.device,e))}cull(e,t,s=null){let r=this.renderer.scene.clusteredLightingEnabled;e.visibleThisFrame=!0,this.prepareShadowMap(e);let i=e._type,a=i===Ue?1:6;for(let o=0;o<a;o++){let n=e.getRenderData(null,o),c=n.shadowCamera;c.nearClip=e.attenuationEnd/1e3,c.farClip=e.attenuationEnd;let h=c._node,d=e._node;if(h.setPosition(d.getPosition()),i===Ue)c.fov=e._outerConeAngle*2,h.setRotation(d.getRotation()),h.rotateLocal(-90,0,0);else if(i===ze)if(r){let m=2/(this.shadowRenderer.lightTextureAtlas.shadowAtlasResolution*e.atlasViewport.z/3)*this.shadowRenderer.lightTextureAtlas.shadowEdgePixels;c.fov=Math.atan(1+m)*O.RAD_TO_DEG*2}else c.fov=90;c.updateFrustum(),i===Ue&&this.shadowRenderer.cullShadowCasters(t,e,n.visibleCasters,c,s)}i===ze&&this.shadowRenderer.cullShadowCastersOmni(t,e,s)}prepareLights(e,t){e.length=0;let s;for(let r=0;r<t.length;r++){let i=t[r];if(this.shadowRenderer.needsShadowRendering(i)&&i.atlasViewportAllocated){e.push(i);for(let a=0;a<i.numShadowFaces;a++)s=this.shadowRenderer.prepareFace(i,null,a)}}return s}buildNonClusteredRenderPasses(e,t){for(let s=0;s<t.length;s++){let r=t[s];if(this.shadowRenderer.needsShadowRendering(r)){let i=r._type===Ue,a=r.numShadowFaces;for(let o=0;o<a;o++){let n=new Gh(this.device,this.shadowRenderer,r,o,i);e.addRenderPass(n)}}}}};var zh=class extends ft{constructor(e,t,s,r,i){super(e),this.shadowRenderer=t,this.light=s,this.camera=r,this.cascadeMask=i,this.allCascadesRendering=i===(1<<s.numShadowFaces)-1}frameUpdate(){super.frameUpdate(),this.enabled&&this.executeEnabled&&this.shadowRenderer.renderer.culler.requestDirectionalShadowCull(this.light,this.camera,this.cascadeMask)}execute(){let{light:e,camera:t,shadowRenderer:s,allCascadesRendering:r,cascadeMask:i}=this,a=e.numShadowFaces,o=e.shadowUpdateOverrides;for(let n=0;n<a;n++)i&1<<n&&(s.renderFace(e,t,n,!r),o?.[n]===Ci&&(o[n]=ms));r&&(e._shadowCascadesInvalidated=!1)}after(){this.executeEnabled&&this.shadowRenderer.renderVsm(this.light,this.camera,this.cascadeMask)}};var Vm=new J,GS=[new J,new J,new J,new J],VS=[!1,!1,!1,!1],zS=[0,0,0,0],_r=new y,HS=new N,Me=[new y,new y,new y,new y,new y,new y,new y,new y],zm={min:0,max:0};function kP(l,e,t){Me[0].x=Me[1].x=Me[2].x=Me[3].x=e.x,Me[1].y=Me[3].y=Me[7].y=Me[5].y=e.y,Me[2].z=Me[3].z=Me[6].z=Me[7].z=e.z,Me[4].x=Me[5].x=Me[6].x=Me[7].x=t.x,Me[0].y=Me[2].y=Me[4].y=Me[6].y=t.y,Me[0].z=Me[1].z=Me[4].z=Me[5].z=t.z;let s=9999999999,r=-9999999999;for(let i=0;i<8;++i){l.transformPoint(Me[i],Me[i]);let a=Me[i].z;a<s&&(s=a),a>r&&(r=a)}return zm.min=s,zm.max=r,zm}var Hh=class{renderer;shadowRenderer;device;constructor(e,t){this.renderer=e,this.shadowRenderer=t,this.device=e.device}prepareShadowMap(e,t=null){if(e.visibleThisFrame=!0,e._shadowMap||(e._shadowMap=Bs.create(this.device,e)),t)for(let s=0;s<e.numCascades;s++)this.shadowRenderer.prepareFace(e,t,s)}cull(e,t,s,r=null,i=this.getCascadeMask(e)){let a=s._nearClip;this.generateSplitDistances(e,a,Math.min(s._farClip,e.shadowDistance));for(let n=0;n<e.numCascades;n++){if(!(i&1<<n))continue;let c=e.getRenderData(s,n),h=c.shadowCamera;c.shadowViewport.copy(e.cascades[n]),c.shadowScissor.copy(e.cascades[n]);let d=h._node,f=e._node;d.setPosition(f.getPosition()),d.setRotation(f.getRotation()),d.rotateLocal(-90,0,0);let u=n===0?a:e._shadowCascadeDistances[n-1],m=e._shadowCascadeDistances[n],_=s.getFrustumCorners(u,m);_r.set(0,0,0);let p=s.node.getWorldTransform();for(let F=0;F<8;F++)p.transformPoint(_[F],_[F]),_r.add(_[F]);_r.mulScalar(1/8);let g=0;for(let F=0;F<8;F++){let Y=_[F].sub(_r).length();Y>g&&(g=Y)}let T=d.right,S=d.up,x=d.forward,C=.25*e._shadowResolution/g,E=Math.ceil(_r.dot(S)*C)/C,v=Math.ceil(_r.dot(T)*C)/C,A=S.mulScalar(E),D=T.mulScalar(v),R=_r.dot(x),w=x.mulScalar(R);_r.add2(A,D).add(w),d.setPosition(_r),d.translateLocal(0,0,1e6),h.nearClip=.01,h.farClip=2e6,h.orthoHeight=g,h.updateFrustum(),this.shadowRenderer.cullShadowCasters(t,e,c.visibleCasters,h,r);let M=1<<n,P=c.visibleCasters,L=P.length,G=0,U=GS[n];for(let F=0;F<L;F++){let Y=P[F];Y.shadowCascadeMask&M&&(P[G++]=Y,G===1?U.copy(Y.aabb):U.add(Y.aabb))}L!==G&&(P.length=G),VS[n]=G>0,zS[n]=g,e._isPcss&&(c.shadowCasterAabbValid=G>0,c.shadowCasterAabbValid&&(c.shadowCasterAabb??(c.shadowCasterAabb=new J),c.shadowCasterAabb.copy(U)))}let o=!1;if(e._isPcss)for(let n=0;n<e.numCascades;n++){let c=e.getRenderData(s,n);c.shadowCasterAabbValid&&(o?Vm.add(c.shadowCasterAabb):(Vm.copy(c.shadowCasterAabb),o=!0))}for(let n=0;n<e.numCascades;n++){if(!(i&1<<n))continue;let c;if(o)c=Vm;else if(VS[n])c=GS[n];else continue;let h=e.getRenderData(s,n),d=h.shadowCamera,f=d._node;HS.copy(f.getWorldTransform()).invert();let u=kP(HS,c.getMin(),c.getMax());f.translateLocal(0,0,u.max+.1),d.farClip=u.max-u.min+.2,h.projectionCompensation=zS[n]}}generateSplitDistances(e,t,s){e._shadowCascadeDistances.fill(s);for(let r=1;r<e.numCascades;r++){let i=r/e.numCascades,a=t+(s-t)*i,o=t*(s/t)**i,n=O.lerp(a,o,e.cascadeDistribution);e._shadowCascadeDistances[r-1]=n}}getCascadeMask(e){if(e._shadowCascadesInvalidated)return(1<<e.numCascades)-1;let t=0;for(let s=0;s<e.numCascades;s++)e.shadowUpdateOverrides?.[s]!==ms&&(t|=1<<s);return t}getLightRenderPass(e,t){let s=null;if(this.shadowRenderer.needsShadowRendering(e)){let r=this.getCascadeMask(e);if(!r)return null;let i=e.numShadowFaces,a;for(let o=0;o<i;o++)a=this.shadowRenderer.prepareFace(e,t,o);s=new zh(this.device,this.shadowRenderer,e,t,r),this.shadowRenderer.setupRenderPass(s,a,s.allCascadesRendering)}return s}};var Hm=new Set,GP=new Zr,Us=[],Wh=[],WS=new N,XS=new N,Li=new Float32Array(2),An=new ne(1,1,0,0),YS=new N;function Wm(l){return l.enabled&&l.castShadows&&l.shadowUpdateMode!==ms&&l.visibleThisFrame}function VP(l,e){return Math.exp(-(l*l)/(2*e*e))}function zP(l){let e=(l-1)/6,t=(l-1)*.5,s=new Array(l),r=0;for(let i=0;i<l;++i)s[i]=VP(i-t,e),r+=s[i];for(let i=0;i<l;++i)s[i]/=r;return s}var Xh=class{shadowPassCache=[];_casterLists=[];constructor(e,t){this.device=e.device,this.renderer=e,this.lightTextureAtlas=t;let s=this.device.scope;this.sourceId=s.resolve("source"),this.pixelOffsetId=s.resolve("pixelOffset"),this.weightId=s.resolve("weight[0]"),this.blurVsmShader=[{},{}],this.blurVsmWeights={},this.shadowMapLightRadiusId=s.resolve("light_radius"),this.shadowMapLightRadiusId.setValue(0),this.viewUniformFormat=null,this.blendStateWrite=new Ve,this.blendStateNoWrite=new Ve,this.blendStateNoWrite.setColorWrite(!1,!1,!1,!1)}static createShadowCamera(e,t,s,r){let i=bs.create(e,Na,s,r),a=Jt.get(t),o=a?.vsm??!1,n=a?.pcf??!1;return o?i.clearColor=new z(0,0,0,0):i.clearColor=new z(1,1,1,1),i.clearDepthBuffer=!0,i.clearStencilBuffer=!1,i.clearColorBuffer=!n,i}_cullShadowCastersInternal(e,t,s){let r=e.length;for(let i=0;i<r;i++){let a=e[i];a.castShadow&&a.visible&&(!a.cull||a._isVisible(s))&&(a.visibleThisFrame=!0,t.push(a))}}cullShadowCasters(e,t,s,r,i){this.renderer.scene?.fire(nn,null),s.length=0;let a=this._collectCasterLists(e,t,i);for(let o=0;o<a.length;o++)this._cullShadowCastersInternal(a[o],s,r);s.sort(this.sortCompareShader),this.renderer.scene?.fire(ln,null)}_collectCasterLists(e,t,s){let r=this._casterLists;if(r.length=0,s)r.push(s);else{let i=e.layerList,a=i.length;for(let o=0;o<a;o++){let n=i[o];n._lightsSet.has(t)&&(Hm.has(n)||(Hm.add(n),r.push(n.shadowCasters)))}Hm.clear()}return r}cullShadowCastersOmni(e,t,s){this.renderer.scene?.fire(nn,null);for(let m=0;m<6;m++){let _=t.getRenderData(null,m),p=_.visibleCasters;p.length=0,Us[m]=p,Wh[m]=_.shadowCamera}let r=t._node.getPosition(),i=r.x,a=r.y,o=r.z,n=Wh[0],c=n.nearClip,h=n.farClip,d=Math.tan(n.fov*.5*O.DEG_TO_RAD),f=h*d,u=this._collectCasterLists(e,t,s);for(let m=0;m<u.length;m++){let _=u[m],p=_.length;for(let g=0;g<p;g++){let T=_[g];if(!T.castShadow||!T.visible)continue;if(!T.cull||T.isVisibleFunc){for(let ae=0;ae<6;ae++)(!T.cull||T._isVisible(Wh[ae]))&&(T.visibleThisFrame=!0,Us[ae].push(T));continue}let S=T.aabb.center,x=T._aabb.halfExtents,C=x.x,E=x.y,v=x.z,A=S.x-i,D=S.y-a,R=S.z-o;if(A>f+C||A<-f-C||D>f+E||D<-f-E||R>f+v||R<-f-v)continue;let w=d*A,M=d*D,P=d*R,L=-(d*C+E),G=-(d*C+v),U=-(d*E+C),F=-(d*E+v),Y=-(d*v+C),K=-(d*v+E),W=!1;A+C>c&&A-C<h&&w-D>L&&w+D>L&&w-R>G&&w+R>G&&(Us[0].push(T),W=!0),-A+C>c&&-A-C<h&&-w-D>L&&-w+D>L&&-w-R>G&&-w+R>G&&(Us[1].push(T),W=!0),D+E>c&&D-E<h&&M-A>U&&M+A>U&&M-R>F&&M+R>F&&(Us[2].push(T),W=!0),-D+E>c&&-D-E<h&&-M-A>U&&-M+A>U&&-M-R>F&&-M+R>F&&(Us[3].push(T),W=!0),R+v>c&&R-v<h&&P-A>Y&&P+A>Y&&P-D>K&&P+D>K&&(Us[4].push(T),W=!0),-R+v>c&&-R-v<h&&-P-A>Y&&-P+A>Y&&-P-D>K&&-P+D>K&&(Us[5].push(T),W=!0),W&&(T.visibleThisFrame=!0)}}for(let m=0;m<6;m++)Us[m].sort(this.sortCompareShader),Us[m]=null,Wh[m]=null;this.renderer.scene?.fire(ln,null)}sortCompareShader(e,t){let s=e._sortKeyShadow,r=t._sortKeyShadow;return s===r?t.mesh.id-e.mesh.id:r-s}setupRenderState(e,t){let r=this.renderer.scene.clusteredLightingEnabled?t._isPcf:t._isPcf&&t._type!==ze;e.setBlendState(r?this.blendStateNoWrite:this.blendStateWrite),e.setDepthState(t.shadowDepthState),e.setStencilState(null,null)}dispatchUniforms(e,t,s,r){let i=t._node;e._type!==te&&(this.renderer.dispatchViewPos(i.getPosition()),this.shadowMapLightRadiusId.setValue(e.attenuationEnd)),WS.setTRS(i.getPosition(),i.getRotation(),y.ONE).invert(),XS.mul2(t.projectionMatrix,WS);let a=s.shadowViewport;t.rect=a,t.scissorRect=s.shadowScissor,YS.setViewport(a.x,a.y,a.z,a.w),s.shadowMatrix.mul2(YS,XS),e._type===te&&e._shadowMatrixPalette.set(s.shadowMatrix.data,r*16)}getShadowPass(e){let t=e._type,s=e._shadowType,r=this.shadowPassCache[t]?.[s];if(!r){let i=`ShadowPass_${t}_${s}`;r=at.get(this.device).allocate(i,{isShadow:!0,lightType:t,shadowType:s}),this.shadowPassCache[t]||(this.shadowPassCache[t]=[]),this.shadowPassCache[t][s]=r}return r.index}submitCasters(e,t,s){let r=this.device,i=this.renderer,a=i.scene,o=this.getShadowPass(t),n=s.shaderParams,c=s.renderTarget.flipY?-1:1,h=null,d=null;i.normalMatrixId.setValue(Ss.IDENTITY.data);let f=e.length;for(let u=0;u<f;u++){let m=e[u],_=m.mesh,p=m.instancingData;if(p&&p.count<=0&&!m.getDrawCommands(s))continue;m.ensureMaterial(r);let g=m.material;i.setSkinning(r,m),g!==h?(h=g,g.prepareForRender(r,a),g.setParameters(r),i.setupMaterialBindGroup(g),i.alphaTestId.setValue(g.alphaTest)):i.restoreMaterialOverrides(d,g),i.setupCullModeAndFrontFace(!0,c,m),i.needsMaterialOverrideBindGroup(m,g)&&i.setupMaterialOverrideBindGroup(m),m.setParameters(r),d=m;let T=m.getShaderInstance(o,GP,a,n,this.viewUniformFormat),S=T.shader;if(S.failed){m._scopeParameters.length>0&&m.restoreReplacedParameters(g);continue}m._sortKeyShadow=S.id*4194304+(g.id&4194303),r.setShader(S),i.setupViewBindGroup(S),i.setVertexBuffers(r,_),i.setMorphing(r,m.morphInstance),p&&r.setVertexBuffer(p.vertexBuffer),i.setMeshInstanceMatrices(m);let x=S.usesMeshInstanceStorage?i.updateStorageSlot(m,S):0;i.setupMeshUniformBuffers(T);let C=m.renderStyle,E=m.getDrawCommands(s);r.draw(_.primitive[C],_.indexBuffer[C],p?.count,E,!0,!0,x),m._scopeParameters.length>0&&m.restoreReplacedParameters(g),i._shadowDrawCalls++,p&&i._instancedDrawCalls++}}needsShadowRendering(e){return Wm(e)}getLightRenderData(e,t,s){return e.getRenderData(e._type===te?t:null,s)}setupRenderPass(e,t,s){let r=t.renderTarget;e.init(r),e.depthStencilOps.clearDepthValue=1,e.depthStencilOps.clearDepth=s,r.depthBuffer?e.depthStencilOps.storeDepth=!0:(e.colorOps.clearValue.copy(t.clearColor),e.colorOps.clear=s,e.depthStencilOps.storeDepth=!1),e.requiresCubemaps=!1}prepareFace(e,t,s){let r=e._type,a=this.getLightRenderData(e,t,s).shadowCamera,o=r===te?0:s;return a.renderTarget=e._shadowMap.renderTargets[o],a}renderFace(e,t,s,r){let i=this.device,a=this.getLightRenderData(e,t,s),o=a.shadowCamera;this.dispatchUniforms(e,o,a,s);let n=o.renderTarget,c=this.renderer;c.setCameraUniforms(o,n),c.setupViewUniformBuffers(this.viewUniformFormat,null),c.setupViewport(o,n),r&&c.clear(o),this.setupRenderState(i,e),this.submitCasters(a.visibleCasters,e,o)}renderVsm(e,t,s=(1<<e.numShadowFaces)-1){e._isVsm&&e._vsmBlurSize>1&&(!this.renderer.scene.clusteredLightingEnabled||e._type===te)&&this.applyVsmBlur(e,t,s)}getVsmBlurShader(e,t){let s=this.blurVsmShader,r=s[e][t];if(!r){this.blurVsmWeights[t]=zP(t);let i=new Map;i.set("{SAMPLES}",t),e===1&&i.set("GAUSS",""),r=ot.createShader(this.device,{uniqueName:`blurVsm${e}${t}`,attributes:{vertex_position:le},vertexChunk:"fullscreenQuadVS",fragmentChunk:"blurVSMPS",fragmentDefines:i}),s[e][t]=r}return r}applyVsmBlur(e,t,s){let r=this.device;r.setBlendState(Ve.NOBLEND);let o=e.getRenderData(e._type===te?t:null,0).shadowCamera.renderTarget,n=this.renderer.shadowMapCache.get(r,e),c=n.renderTargets[0],h=e.vsmBlurMode,d=e._vsmBlurSize,f=this.getVsmBlurShader(h,d),u=e._shadowResolution;if(An.set(1,1,u-2,u-2),this.sourceId.setValue(o.colorBuffer),Li[0]=1/e._shadowResolution,Li[1]=0,this.pixelOffsetId.setValue(Li),h===gg&&this.weightId.setValue(this.blurVsmWeights[d]),ka(r,c,f,null,An,"VSMShadowBlur"),this.sourceId.setValue(c.colorBuffer),Li[1]=Li[0],Li[0]=0,this.pixelOffsetId.setValue(Li),e._type===te&&s!==(1<<e.numCascades)-1)for(let m=0;m<e.numCascades;m++){if(!(s&1<<m))continue;let _=e.cascades[m],p=Math.max(1,_.x*u),g=Math.max(1,_.y*u),T=Math.min(u-1,(_.x+_.z)*u),S=Math.min(u-1,(_.y+_.w)*u);An.set(p,g,T-p,S-g),ka(r,o,f,null,An,"VSMShadowBlur")}else ka(r,o,f,null,An,"VSMShadowBlur");this.renderer.shadowMapCache.add(e,n)}initViewUniformFormat(){this.viewUniformFormat||(this.viewUniformFormat=new Te(this.device,[new I("matrix_viewProjection",Be),new I("camera_params",Pe),new I("blueNoiseJitter",Pe),new I("view_position",Z),new I("light_radius",b),new I("textureBias",b)],{pack:!0}))}frameUpdate(){this.initViewUniformFormat()}};var Yh=class{_empty=null;_allocated=[];_clusters=new Map;_recycled=[];_requestedSteps=[];constructor(e){this.device=e}destroy(){this._empty&&(this._empty.destroy(),this._empty=null),this._allocated.forEach(e=>{e.destroy()}),this._allocated.length=0,this._recycled.forEach(e=>{e.destroy()}),this._recycled.length=0,this._clusters.clear(),this._requestedSteps.length=0}get count(){return this._allocated.length}get empty(){return this._empty??this.createEmpty()}createEmpty(){if(!this._empty){let e=new gn(this.device);e.name="ClusterEmpty",e.update([]),this._empty=e}return this._empty}reset(){this._requestedSteps.length=0}request(e){this._requestedSteps.push(e)}upload(e){let t=this._recycled;t.push(...this._allocated),this._allocated.length=0,this._clusters.clear();let s=this._requestedSteps;for(let r=0;r<s.length;r++){let i=s[r];i.lightClusters=null;let a=i.layer;if(a.hasClusteredLights&&a.meshInstances.length){let o=a.getLightIdHash(),c=this._clusters.get(o)?.lightClusters;c||(c=t.pop()??new gn(this.device),this._allocated.push(c),this._clusters.set(o,i)),i.lightClusters=c}}t.forEach(r=>r.destroy()),t.length=0,this._clusters.forEach(r=>{r.lightClusters.update(r.layer.clusteredLightsSet,e)})}};var Qr=new ne,Xm=[],jh=class l extends ft{_quadRenderer2D=null;_quadRendererCube=null;_filteredLights=[];_forceCopy=!1;_evtDeviceRestored=null;constructor(e,t){super(e),this._cubeSlotsOffsets=t,this.requiresCubemaps=!1,this.blitTextureId=e.scope.resolve("blitTexture"),this.invViewProjId=e.scope.resolve("invViewProj"),this._evtDeviceRestored=e.on("devicerestored",this.onDeviceRestored,this)}destroy(){this._quadRenderer2D?.destroy(),this._quadRenderer2D=null,this._quadRendererCube?.destroy(),this._quadRendererCube=null,this._evtDeviceRestored?.off(),this._evtDeviceRestored=null}static create(e,t){let s=new l(e.device,t);return s.init(e),s.colorOps.clear=!1,s.depthStencilOps.clearDepth=!1,s}onDeviceRestored(){this._forceCopy=!0}update(e){let t=this._filteredLights;this.filter(e,t),this.executeEnabled=t.length>0}filter(e,t){for(let s=0;s<e.length;s++){let r=e[s];if(r._type===te||!r.atlasViewportAllocated)continue;let i=r.cookie&&r.cookie.uploadVersion!==r.cookieRenderVersion;!r.atlasSlotUpdated&&!i&&!this._forceCopy||r.enabled&&r.cookie&&r.visibleThisFrame&&t.push(r)}this._forceCopy=!1}initInvViewProjMatrices(){if(!Xm.length)for(let e=0;e<6;e++){let t=bs.create(this.device,null,ze,e),s=t.projectionMatrix,r=t.node.getLocalTransform().clone().invert();Xm[e]=new N().mul2(s,r).invert()}}get quadRenderer2D(){if(!this._quadRenderer2D){let e=ot.createShader(this.device,{uniqueName:"cookieRenderer2d",attributes:{vertex_position:le},vertexChunk:"cookieBlitVS",fragmentChunk:"cookieBlit2DPS"});this._quadRenderer2D=new fr(e)}return this._quadRenderer2D}get quadRendererCube(){if(!this._quadRendererCube){let e=ot.createShader(this.device,{uniqueName:"cookieRendererCube",attributes:{vertex_position:le},vertexChunk:"cookieBlitVS",fragmentChunk:"cookieBlitCubePS"});this._quadRendererCube=new fr(e)}return this._quadRendererCube}execute(){this.device.setDrawStates();let t=this.renderTarget.colorBuffer.width,s=this._cubeSlotsOffsets,r=this._filteredLights;for(let i=0;i<r.length;i++){let a=r[i],o=a.numShadowFaces,n=o>1?this.quadRendererCube:this.quadRenderer2D;o>1&&this.initInvViewProjMatrices(),this.blitTextureId.setValue(a.cookie),a.cookieRenderVersion=a.cookie.uploadVersion;for(let c=0;c<o;c++){if(Qr.copy(a.atlasViewport),o>1){let h=Qr.z/3,d=s[c];Qr.x+=h*d.x,Qr.y+=h*d.y,Qr.z=h,Qr.w=h,this.invViewProjId.setValue(Xm[c].data)}Qr.mulScalar(t),n.render(Qr)}}r.length=0}};var qh=class extends ft{constructor(e,t,s){super(e),this.requiresCubemaps=!1,this.shadowRenderer=t,this.shadowRendererLocal=s}update(e){let t=this.shadowRendererLocal.shadowLights,s=this.shadowRendererLocal.prepareLights(t,e),r=t.length;this.enabled=r>0,r&&this.shadowRenderer.setupRenderPass(this,s,!1)}frameUpdate(){if(super.frameUpdate(),this.enabled&&this.executeEnabled){let e=this.shadowRendererLocal.shadowLights,t=this.shadowRenderer.renderer.culler;for(let s=0;s<e.length;s++)t.requestLocalShadowCull(e[s])}}execute(){let e=this.shadowRendererLocal.shadowLights,t=e.length;for(let s=0;s<t;s++){let r=e[s];for(let i=0;i<r.numShadowFaces;i++)this.shadowRenderer.renderFace(r,null,i,!0)}e.length=0}};var $h=class extends Dt{constructor(e,t,s,r,i){super(e),this.renderer=t,t.worldClustersAllocator.createEmpty(),this.cookiesRenderPass=jh.create(i.cookieRenderTarget,i.cubeSlotsOffsets),this.beforePasses.push(this.cookiesRenderPass),this.shadowRenderPass=new qh(e,s,r),this.beforePasses.push(this.shadowRenderPass)}update(e,t,s,r){this.renderer.worldClustersAllocator.reset(),this.cookiesRenderPass.enabled=t,t&&this.cookiesRenderPass.update(s),this.shadowRenderPass.enabled=e,e&&this.shadowRenderPass.update(r)}destroy(){this.cookiesRenderPass.destroy(),this.cookiesRenderPass=null}execute(){let{renderer:e}=this;e.worldClustersAllocator.upload(e.scene.lighting)}};var Ym=new ol,jm=new Set,Kh=class{processingMeshInstances=new Set;_cullCameras=[];_directionalShadowCullRequests=[];_localShadowCullRequests=[];cameraDirShadowLights=new Map;dirLightShadows=new Map;constructor(e){this.renderer=e}cullMeshInstances(e,t,s){let r=s.opaque;r.length=0;let i=s.transparent;i.length=0;let a=e.frustumCulling,o=t.length;for(let n=0;n<o;n++){let c=t[n];c.visible&&(!a||!c.cull||c._isVisible(e))&&(c.visibleThisFrame=!0,(c.transparent?i:r).push(c),(c.skinInstance||c.morphInstance||c.gsplatInstance)&&(this.processingMeshInstances.add(c),c.gsplatInstance&&c.gsplatInstance.cameras.push(e)))}}cullLights(e,t){let{scene:s}=this.renderer,r=s.clusteredLightingEnabled,i=s.physicalUnits;for(let a=0;a<t.length;a++){let o=t[a];if(o.enabled)if(o._type!==te)if(o.getBoundingSphere(Ym),e.frustum.containsSphere(Ym)){o.visibleThisFrame=!0,o.usePhysicalUnits=i;let n=e.getScreenSize(Ym);o.maxScreenSize=Math.max(o.maxScreenSize,n)}else r||o.castShadows&&!o.shadowMap&&(o.visibleThisFrame=!0);else o.usePhysicalUnits=s.physicalUnits}}cullShadowmaps(e){let{renderer:t}=this,s=this._localShadowCullRequests;for(let i=0;i<s.length;i++)t._shadowRendererLocal.cull(s[i].light,e);let r=this._directionalShadowCullRequests;for(let i=0;i<r.length;i++){let{light:a,camera:o,shadowCascadeMask:n}=r[i];t._shadowRendererDirectional.cull(a,e,o,null,n)}}consumeOneShotShadows(){let{renderer:e}=this,t=this._localShadowCullRequests;for(let r=0;r<t.length;r++){let{light:i}=t[r];e._shadowMapUpdates+=i.numShadowFaces,i.shadowUpdateMode===Ci&&(i.shadowUpdateMode=ms)}let s=this._directionalShadowCullRequests;for(let r=0;r<s.length;r++){let{light:i,shadowCascadeMask:a}=s[r];for(let o=a;o;o&=o-1)e._shadowMapUpdates++;i.shadowUpdateMode===Ci&&(i.shadowUpdateMode=ms)}}requestDirectionalShadowCull(e,t,s){let r=e.getRenderData(t,0);r.shadowCullRequested||(r.shadowCullRequested=!0,this._directionalShadowCullRequests.push(r)),r.shadowCascadeMask|=s}requestLocalShadowCull(e){let t=e.getRenderData(null,0);t.shadowCullRequested||(t.shadowCullRequested=!0,this._localShadowCullRequests.push(t))}collectDirectionalShadowLights(e){let{renderer:t}=this;this.cameraDirShadowLights.clear();let s=e.cameras;for(let r=0;r<s.length;r++){let i=s[r];if(i.enabled){let a=i.camera,o,n=a.layers;for(let c=0;c<n.length;c++){let h=e.getLayerById(n[c]);if(h){let d=h.getLightList().directional;for(let f=0;f<d.length;f++){let u=d[f];u.castShadows&&!jm.has(u)&&(jm.add(u),o=o??[],o.push(u),t._shadowRendererDirectional.prepareShadowMap(u,a))}}}o&&this.cameraDirShadowLights.set(a,o),jm.clear()}}}updateLightVisibility(e){let{renderer:t}=this,{scene:s}=t,r=this._directionalShadowCullRequests;for(let h=0;h<r.length;h++)r[h].shadowCullRequested=!1,r[h].shadowCascadeMask=0;r.length=0;let i=this._localShadowCullRequests;for(let h=0;h<i.length;h++)i[h].shadowCullRequested=!1;i.length=0;let a=t.lights;for(let h=0;h<a.length;h++)a[h].beginFrame();let o=e.cameras.length;for(let h=0;h<o;h++){let d=e.cameras[h];d.camera.updateFrustum();let f=d.layers;for(let u=0;u<f.length;u++){let m=e.getLayerById(f[u]);m&&m.enabled&&this.cullLights(d.camera,m._lights)}}let n=s.clusteredLightingEnabled;n&&t.updateLightTextureAtlas();let c=t.localLights;for(let h=0;h<c.length;h++){let d=c[h];d._type!==te&&(n?d.atlasSlotUpdated&&d.shadowUpdateMode===ms&&(d.shadowUpdateMode=Ci):d.castShadows&&d.visibleThisFrame&&!d._shadowMap&&(t._shadowRendererLocal.prepareShadowMap(d),d.shadowUpdateMode===ms&&(d.shadowUpdateMode=Ci)))}this.collectDirectionalShadowLights(e)}requestMeshInstanceCull(e,t){e.addCullLayer(t)&&this._cullCameras.push(e)}executeMeshInstanceCull(){let{renderer:e}=this,{scene:t}=e,s=this._cullCameras;for(let r=0;r<s.length;r++){let i=s[r],a=i.node?.camera??null;t?.fire(nn,a),i.updateFrustum();for(let o of i.cullLayers)this.cullMeshInstances(i,o.meshInstances,o.getCulledInstances(i));t?.fire(ln,a),i.clearCullLayers()}s.length=0}cullComposition(e){let{renderer:t}=this,{scene:s}=t;this.processingMeshInstances.clear(),t._camerasRendered+=e.cameras.length,this.executeMeshInstanceCull(),this.cullShadowmaps(e),s?.fire(Gg)}};var qm=0,Zh=new N,Qh=new N,Jh=new N,jS=new Ss,$m=new Set,Km=new Set,Zm=new pi,Rn=[0,0,0,1],ed={color:Rn,depth:1,stencil:0,flags:0},qS=[new k(.5,.333333),new k(.25,.666667),new k(.75,.111111),new k(.125,.444444),new k(.625,.777778),new k(.375,.222222),new k(.875,.555556),new k(.0625,.888889),new k(.5625,.037037),new k(.3125,.37037),new k(.8125,.703704),new k(.1875,.148148),new k(.6875,.481481),new k(.4375,.814815),new k(.9375,.259259),new k(.03125,.592593)],WP=new N,XP=new N,YP=new N,jP=new N,Qm=new Set,Jm=[],ep=[],tp=class{bindGroup;pass=-1;constructor(e){this.bindGroup=e}},sp=class{uniformBuffer;textureBindGroups=new Map;constructor(e){this.uniformBuffer=e}},td=class{clustersDebugRendered=!1;scene;culler;worldClustersAllocator;lights=[];localLights=[];_viewUniformFormats=[new Map,new Map];_lightSlotUniforms=[];_viewUniformBuffers=new WeakMap;_viewTextureBindGroups=[];_viewPass=0;_passViewCount=0;_passViewUniformBuffers=[];_boundViewBindGroupFormat=null;_emptyMeshBindGroupBound=!1;_emptyMeshUniformBufferBound=!1;_meshInstanceStorageVersion=-1;_dynamicViewBindGroup=new pi;_passDynamicViewBindGroups=[];_passDynamicViewOffsets=[];_viewBindGroups=[];_viewBindGroupOffsets=[];_viewOffsetScratch=new Uint32Array(1);blueNoise=new Oh(123);gsplatDirector=null;constructor(e,t){this.device=e,this.scene=t,this.worldClustersAllocator=new Yh(e),this.lightTextureAtlas=new Uh(e),this.shadowMapCache=new kh,this.shadowRenderer=new Xh(this,this.lightTextureAtlas),this._shadowRendererLocal=new Vh(this,this.shadowRenderer),this._shadowRendererDirectional=new Hh(this,this.shadowRenderer),this.culler=new Kh(this),this.scene.clusteredLightingEnabled&&(this._renderPassUpdateClustered=new $h(this.device,this,this.shadowRenderer,this._shadowRendererLocal,this.lightTextureAtlas)),this._skinTime=0,this._morphTime=0,this._cullTime=0,this._shadowMapTime=0,this._lightClustersTime=0,this._layerCompositionUpdateTime=0,this._shadowDrawCalls=0,this._skinDrawCalls=0,this._instancedDrawCalls=0,this._shadowMapUpdates=0,this._numDrawCallsCulled=0,this._camerasRendered=0,this._lightClusters=0,this._gsplatCount=0;let s=e.scope;this.boneTextureId=s.resolve("texture_poseMap"),this.modelMatrixId=s.resolve("matrix_model"),this.normalMatrixId=s.resolve("matrix_normal"),this.viewInvId=s.resolve("matrix_viewInverse"),this.viewPos=new Float32Array(3),this.viewPosId=s.resolve("view_position"),this.projId=s.resolve("matrix_projection"),this.projSkyboxId=s.resolve("matrix_projectionSkybox"),this.viewId=s.resolve("matrix_view"),this.viewId3=s.resolve("matrix_view3"),this.viewProjId=s.resolve("matrix_viewProjection"),this.flipYId=s.resolve("projectionFlipY"),this.tbnBasis=s.resolve("tbnBasis"),this.cameraParams=new Float32Array(4),this.cameraParamsId=s.resolve("camera_params"),this.viewportSize=new Float32Array(4),this.viewportSizeId=s.resolve("viewport_size"),this.viewIndexId=s.resolve("view_index"),this.viewIndexId.setValue(0),this.blueNoiseJitterVersion=0,this.blueNoiseJitterVec=new ne,this.blueNoiseJitterData=new Float32Array(4),this.blueNoiseJitterId=s.resolve("blueNoiseJitter"),this.blueNoiseTextureId=s.resolve("blueNoiseTex32"),this.alphaTestId=s.resolve("alpha_ref"),this.exposureId=s.resolve("exposure"),this.morphPositionTex=s.resolve("morphPositionTex"),this.morphNormalTex=s.resolve("morphNormalTex"),this.morphTexParams=s.resolve("morph_tex_params"),this.lightCube=new Nh,this.constantLightCube=s.resolve("lightCube[0]")}destroy(){this.shadowRenderer=null,this._shadowRendererLocal=null,this._shadowRendererDirectional=null,this.shadowMapCache.destroy(),this.shadowMapCache=null,this._renderPassUpdateClustered?.destroy(),this._renderPassUpdateClustered=null,this.worldClustersAllocator.destroy(),this.worldClustersAllocator=null,this.lightTextureAtlas.destroy(),this.lightTextureAtlas=null,this._viewTextureBindGroups.forEach(e=>e.destroy()),this._viewTextureBindGroups.length=0}setupViewport(e,t){let s=this.device,r=t?t.width:s.width,i=t?t.height:s.height,a=e.rect,o=Math.floor(a.x*r),n=Math.floor(a.y*i),c=Math.floor(a.z*r),h=Math.floor(a.w*i);if(s.setViewport(o,n,c,h),e._scissorRectClear){let d=e.scissorRect;o=Math.floor(d.x*r),n=Math.floor(d.y*i),c=Math.floor(d.z*r),h=Math.floor(d.w*i)}s.setScissor(o,n,c,h)}setCameraUniforms(e,t){let s=t?.flipY,r=null;if(e.xrActive)r=e.xrViews,e.updateViewTransforms();else{let c=e.projectionMatrix;e.calculateProjection&&e.calculateProjection(c,ba);let h=e.getProjectionMatrixSkybox(),d=this.device.isWebGPU;c=Vt.applyShaderProjectionTransform(c,WP,s,d),h=Vt.applyShaderProjectionTransform(h,XP,s,d);let{jitter:f}=e,u=0,m=0;if(f>0){let _=t?t.width:this.device.width,p=t?t.height:this.device.height,g=qS[this.device.renderVersion%qS.length];u=f*(g.x*2-1)/_,m=f*(g.y*2-1)/p,c=YP.copy(c),c.data[8]+=u,c.data[9]+=m,h=jP.copy(h),h.data[8]+=u,h.data[9]+=m,this.blueNoiseJitterVersion!==this.device.renderVersion&&(this.blueNoiseJitterVersion=this.device.renderVersion,this.blueNoise.vec4(this.blueNoiseJitterVec))}if(this.projId.setValue(c.data),this.projSkyboxId.setValue(h.data),e.calculateTransform)e.calculateTransform(Qh,ba);else{let _=e._node.getPosition(),p=e._node.getRotation();Qh.setTRS(_,p,y.ONE)}this.viewInvId.setValue(Qh.data),Jh.copy(Qh).invert(),this.viewId.setValue(Jh.data),jS.setFromMat4(Jh),this.viewId3.setValue(jS.data),Zh.mul2(c,Jh),this.viewProjId.setValue(Zh.data),e._storeShaderMatrices(Zh,u,m,this.device.renderVersion),this.dispatchViewPos(e._node.getPosition()),e.frustum.setFromMat4(Zh)}this.flipYId.setValue(s?-1:1),this.tbnBasis.setValue(this.device.isWebGPU!==!!s?-1:1);let i=!e.xrActive&&e.jitter>0?this.blueNoiseJitterVec:ne.ZERO;this.blueNoiseJitterData[0]=i.x,this.blueNoiseJitterData[1]=i.y,this.blueNoiseJitterData[2]=i.z,this.blueNoiseJitterData[3]=i.w,this.blueNoiseJitterId.setValue(this.blueNoiseJitterData),this.cameraParamsId.setValue(e.fillShaderParams(this.cameraParams));let a=e.xrActive?e.xrViews[0]??null:null,o=a?a.viewport.z:t?t.width:this.device.width,n=a?a.viewport.w:t?t.height:this.device.height;return o*=e.rect.z,n*=e.rect.w,this.viewportSize[0]=o,this.viewportSize[1]=n,this.viewportSize[2]=1/o,this.viewportSize[3]=1/n,this.viewportSizeId.setValue(this.viewportSize),this.exposureId.setValue(this.scene.physicalUnits?e.getExposure():this.scene.exposure),r}clear(e,t,s,r){let i=(t??e._clearColorBuffer?1:0)|(s??e._clearDepthBuffer?2:0)|(r??e._clearStencilBuffer?4:0);if(i){let a=this.device,o=e._clearColor;Rn[0]=o.r,Rn[1]=o.g,Rn[2]=o.b,Rn[3]=o.a,ed.depth=e._clearDepth,ed.stencil=e._clearStencil,ed.flags=i,a.clear(ed)}}setupCullModeAndFrontFace(e,t,s){let r=s.material,i=t*s.flipFacesFactor*s.node.worldScaleSign,a=r.frontFace;i<0&&(a=a===0?1:0),this.device.setCullMode(e?r.cull:0),this.device.setFrontFace(a)}setupCullMode(e,t,s){this.setupCullModeAndFrontFace(e,t,s)}updateCpuSkinMatrices(e){qm++;let t=e.length;if(t!==0)for(let s=0;s<t;s++){let r=e[s].skinInstance;r&&(r.updateMatrices(e[s].node,qm),r._dirty=!0)}}updateGpuSkinMatrices(e){for(let t of e){let s=t.skinInstance;s&&s._dirty&&(s.updateMatrixPalette(t.node,qm),s._dirty=!1)}}updateMorphing(e){for(let t of e){let s=t.morphInstance;s&&s._dirty&&s.update()}}updateGSplats(e){for(let t of e)t.gsplatInstance?.update()}gpuUpdate(e){this.updateGpuSkinMatrices(e),this.updateMorphing(e),this.updateGSplats(e)}setVertexBuffers(e,t){e.setVertexBuffer(t.vertexBuffer)}setMorphing(e,t){t&&(t.prepareRendering(e),e.setVertexBuffer(t.morph.vertexBufferIds),this.morphPositionTex.setValue(t.texturePositions),this.morphNormalTex.setValue(t.textureNormals),this.morphTexParams.setValue(t._textureParams))}setSkinning(e,t){let s=t.skinInstance;if(s){this._skinDrawCalls++;let r=s.boneTexture;this.boneTextureId.setValue(r)}}dispatchViewPos(e){let t=this.viewPos;t[0]=e.x,t[1]=e.y,t[2]=e.z,this.viewPosId.setValue(t)}getViewUniformFormat(e,t){let s=this._viewUniformFormats[e?1:0],r=s.get(t.key);if(!r){let i=[new I("matrix_view",Be),new I("matrix_viewInverse",Be),new I("matrix_projection",Be),new I("matrix_projectionSkybox",Be),new I("matrix_viewProjection",Be),new I("matrix_view3",Cs),new I("cubeMapRotationMatrix",Cs),new I("view_position",Z),new I("skyboxIntensity",b),new I("viewport_size",Pe),new I("screen_size",Pe),new I("camera_params",Pe),new I("blueNoiseJitter",Pe),new I("exposure",b),new I("view_index",X),new I("light_globalAmbient",Z),new I("textureBias",b),new I("projectionFlipY",b),new I("tbnBasis",b),new I("fog_color",Z),new I("fog_start",b),new I("fog_end",b),new I("fog_density",b)];e&&i.push(new I("shadowAtlasParams",ht),new I("clusterCellsCountByBoundsSize",Z),new I("clusterMaxCells",ct),new I("clusterBoundsMin",Z),new I("numClusteredLights",ct),new I("clusterBoundsDelta",Z),new I("clusterTextureWidth",ct),new I("clusterCellsDot",Rt),new I("clusterCellsMax",Rt));let a=t.slots;for(let o=0;o<a.length;o++)this.getLightSlotUniforms(o).appendFormats(i,a[o]);r=new Te(this.device,i,{pack:!0}),s.set(t.key,r)}return r}getLightSlotUniforms(e){let t=this._lightSlotUniforms;return t[e]??(t[e]=new Bh(this.device,e))}setupViewUniforms(e,t){this.projId.setValue(e.projMat.data),this.projSkyboxId.setValue(e.projMat.data),this.viewId.setValue(e.viewOffMat.data),this.viewInvId.setValue(e.viewInvOffMat.data),this.viewId3.setValue(e.viewMat3.data),this.viewProjId.setValue(e.projViewOffMat.data),this.viewPosId.setValue(e.positionData),this.viewIndexId.setValue(t)}getViewUniformBuffer(e,t){let s=this._viewUniformBuffers.get(e);s||(s=[],this._viewUniformBuffers.set(e,s));let r=s[t];return r||(r=new sp(new Nt(this.device,e,!1)),s[t]=r),r}setupViewUniformBuffers(e,t){let{device:s}=this;this._viewPass++,this._boundViewBindGroupFormat=null,this._emptyMeshBindGroupBound=!1,this._emptyMeshUniformBufferBound=!1,this._meshInstanceStorageVersion=s.meshInstanceStorage?.version??-1,this._boundMaterialBindGroup=null,s.usesMeshBindGroups&&(s.setBindGroup(er,s.emptyBindGroup),this._boundMaterialBindGroup=s.emptyBindGroup);let r=t?t.length:0;if(this._passViewCount=r,t)for(let i=0;i<r;i++){this.setupViewUniforms(t[i],i);let a=this.getViewUniformBuffer(e,i);this._passViewUniformBuffers[i]=a,a.uniformBuffer.update(this._dynamicViewBindGroup),this._passDynamicViewBindGroups[i]=this._viewBindGroups[i]=this._dynamicViewBindGroup.bindGroup,this._passDynamicViewOffsets[i]=this._viewBindGroupOffsets[i]=this._dynamicViewBindGroup.offsets[0]}else{let i=this.getViewUniformBuffer(e,0);this._passViewUniformBuffers[0]=i,i.uniformBuffer.update(this._dynamicViewBindGroup),s.setBindGroup(jt,this._dynamicViewBindGroup.bindGroup,this._dynamicViewBindGroup.offsets)}}setupViewBindGroup(e,t=!1){let s=e.viewBindGroupFormat;if(s===this._boundViewBindGroupFormat&&!t)return;this._boundViewBindGroupFormat=s;let r=this.device,i=this._passViewCount;if(s){let a=this._viewPass,o=this._passViewUniformBuffers;for(let n=0;n<(i||1);n++){let c=this.getViewTextureBindGroup(o[n],s,a);i?(this._viewBindGroups[n]=c,this._viewBindGroupOffsets[n]=c.uniformBufferOffsets[0]):r.setBindGroup(jt,c)}}else if(i)for(let a=0;a<i;a++)this._viewBindGroups[a]=this._passDynamicViewBindGroups[a],this._viewBindGroupOffsets[a]=this._passDynamicViewOffsets[a];else r.setBindGroup(jt,this._dynamicViewBindGroup.bindGroup,this._dynamicViewBindGroup.offsets)}getViewTextureBindGroup(e,t,s){let r=e.textureBindGroups.get(t);if(!r){let i=new bt(this.device,t,e.uniformBuffer);this._viewTextureBindGroups.push(i),r=new tp(i),e.textureBindGroups.set(t,r)}return r.pass!==s&&(r.pass=s,r.bindGroup.update()),r.bindGroup}_boundMaterialBindGroup=null;setupMaterialBindGroup(e){let t=this.device,s=e.uniformBufferBindGroup;!s&&t.usesMeshBindGroups&&(s=t.emptyBindGroup),s&&s!==this._boundMaterialBindGroup&&(t.setBindGroup(er,s),this._boundMaterialBindGroup=s)}setupMaterialOverrideBindGroup(e){let t=this.device,s=e.getMaterialBindGroup(t);s&&s!==this._boundMaterialBindGroup&&(t.setBindGroup(er,s),this._boundMaterialBindGroup=s)}restoreMaterialOverrides(e,t){this.hasMaterialOverrides(e)&&this.setupMaterialBindGroup(t),e._scopeParameters.length>0&&(t.setParameters(this.device,e._scopeParameters),this.alphaTestId.setValue(t.alphaTest))}hasMaterialOverrides(e){return e._materialOverrides.length>0||e._materialTextureOverrides.length>0}needsMaterialOverrideBindGroup(e,t){return this.hasMaterialOverrides(e)||e._materialLayoutVersion!==t._layoutVersion}setupMeshUniformBuffers(e){let t=this.device;if(t.usesMeshBindGroups){if(e.shader.meshBindGroupFormat.empty)this._emptyMeshBindGroupBound||(this._emptyMeshBindGroupBound=!0,t.setBindGroup(ui,t.emptyBindGroup));else{this._emptyMeshBindGroupBound=!1;let r=e.getBindGroup(t);r.update(),t.setBindGroup(ui,r)}if(e.shader.meshUniformBufferEmpty){if(this._emptyMeshUniformBufferBound)return;this._emptyMeshUniformBufferBound=!0}else this._emptyMeshUniformBufferBound=!1;e.getUniformBuffer(t).update(Zm),t.setBindGroup(mi,Zm.bindGroup,Zm.offsets)}}updateStorageSlot(e,t){let s=this.device.meshInstanceStorage,r=e.storageSlot;r<0&&(r=s.allocate(),e.storageSlot=r,e.storageSlotVersion=-1,s.version!==this._meshInstanceStorageVersion&&(this._meshInstanceStorageVersion=s.version,this._viewPass++,this.setupViewBindGroup(t,!0)));let i=e.node;return e.storageSlotVersion!==i._aabbVer&&(e.storageSlotVersion=i._dirtyWorld?-1:i._aabbVer,s.write(r,i.worldTransform.data,i.normalMatrix.data)),r}setMeshInstanceMatrices(e,t=!1){let s=e.node.worldTransform;this.modelMatrixId.setValue(s.data),t&&this.normalMatrixId.setValue(e.node.normalMatrix.data)}collectLights(e){this.lights.length=0,this.localLights.length=0;let t=this.scene._stats,s=e.layerList.length;for(let r=0;r<s;r++){let i=e.layerList[r];if(!Km.has(i)){Km.add(i);let a=i._lights;for(let o=0;o<a.length;o++){let n=a[o];$m.has(n)||($m.add(n),this.lights.push(n),n._type!==te&&this.localLights.push(n))}}}t.lights=this.lights.length,$m.clear(),Km.clear()}updateShaders(e,t){let s=e.length;for(let r=0;r<s;r++){let i=e[r].material;if(i&&!Qm.has(i)&&(Qm.add(i),i.getShaderVariant!==Os.prototype.getShaderVariant)){if(t&&(!i.useLighting||i.emitter&&!i.emitter.lighting))continue;i.clearVariants()}}Qm.clear()}updateFrameUniforms(){this.blueNoiseTextureId.setValue(US(this.device))}beginFrame(e){let t=this.scene,s=t.updateShaders||this.device._shadersDirty,r=0,i=e.layerList,a=i.length;for(let o=0;o<a;o++){let c=i[o].meshInstances,h=c.length;r+=h;for(let d=0;d<h;d++){let f=c[d];f.visibleThisFrame=!1,s&&Jm.push(f),f.skinInstance&&ep.push(f)}}if(s){let o=!t.updateShaders||!this.device._shadersDirty;this.updateShaders(Jm,o),t.updateShaders=!1,this.device._shadersDirty=!1,t._shaderVersion++}this.updateFrameUniforms(),this.updateCpuSkinMatrices(ep),Jm.length=0,ep.length=0}updateLightTextureAtlas(){this.lightTextureAtlas.update(this.localLights,this.scene.lighting)}updateLayerComposition(e){let t=e.layerList.length,r=this.scene._shaderVersion;for(let i=0;i<t;i++){let a=e.layerList[i];a._shaderVersion=r}e._update()}frameUpdate(){this.clustersDebugRendered=!1,this.culler.dirLightShadows.clear()}};var Ya=class{cameraComponent;layer;transparent;renderTarget;lightClusters=null;clearColor=!1;clearDepth=!1;clearStencil=!1;firstCameraUse=!1;lastCameraUse=!1;constructor(e,t,s,r){this.cameraComponent=e,this.layer=t,this.transparent=s,this.renderTarget=r}setupClears(e,t){this.clearColor=e?.clearColorBuffer||t.clearColorBuffer,this.clearDepth=e?.clearDepthBuffer||t.clearDepthBuffer,this.clearStencil=e?.clearStencilBuffer||t.clearStencilBuffer}};var sd=class extends ft{layerComposition;scene;renderer;layerRenderSteps=[];gammaCorrection;toneMapping;sceneTextures;sceneTexturesCamera=null;clearSceneTextures=!1;noDepthClear=!1;constructor(e,t,s,r){super(e),this.layerComposition=t,this.scene=s,this.renderer=r}get rendersAnything(){return this.layerRenderSteps.length>0}addLayerRenderStep(e){this.layerRenderSteps.push(e)}addLayer(e,t,s,r=!0){let i=new Ya(e,t,s,this.renderTarget);if(r){let a=this.layerRenderSteps.length===0;i.setupClears(a?e:void 0,t)}this.addLayerRenderStep(i)}updateDirectionalShadows(){let{renderer:e,layerRenderSteps:t}=this;for(let s=0;s<t.length;s++){let a=t[s].cameraComponent.camera,o=this.renderer.culler.cameraDirShadowLights.get(a);if(o)for(let n=0;n<o.length;n++){let c=o[n];if(e.culler.dirLightShadows.get(c)!==a){e.culler.dirLightShadows.set(c,a);let h=e._shadowRendererDirectional.getLightRenderPass(c,a);h&&this.beforePasses.push(h)}}}}updateCameraBeforePasses(){for(let e=0;e<this.layerRenderSteps.length;e++){let t=this.layerRenderSteps[e];if(t.firstCameraUse){let s=t.cameraComponent?.camera;if(s){let{beforePasses:r}=s;for(let i=0;i<r.length;i++)this.beforePasses.push(r[i])}}}}updateClears(){let e=this.layerRenderSteps[0];if(e){let s=e.cameraComponent.camera,r=s.fullSizeClearRect,i=r&&e.clearColor;if(this.sceneTextures?.length)this.setClearColor(i?s.clearColor:void 0,0);else{let a=this.colorArrayOps.length;for(let o=0;o<a;o++)this.setClearColor(i?s.getClearColor(o):void 0,o)}this.setClearDepth(r&&e.clearDepth&&!this.noDepthClear?s.clearDepth:void 0),this.setClearStencil(r&&e.clearStencil?s.clearStencil:void 0)}}frameUpdate(){super.frameUpdate(),this.updateDirectionalShadows(),this.updateCameraBeforePasses(),this.updateClears();let{renderer:e,scene:t,layerComposition:s,layerRenderSteps:r}=this,i=t.clusteredLightingEnabled;for(let a=0;a<r.length;a++){let o=r[a];i&&e.worldClustersAllocator.request(o),s.isEnabled(o.layer,o.transparent)&&e.culler.requestMeshInstanceCull(o.cameraComponent.camera,o.layer)}}before(){let{layerRenderSteps:e}=this;if(this.clearSceneTextures){let{scope:t}=this.device;this.sceneTextures.forEach(s=>{t.resolve(mm[s]).setValue(null)})}for(let t=0;t<e.length;t++){let s=e[t];s.firstCameraUse&&this.scene.fire(Ng,s.cameraComponent)}}execute(){let{layerComposition:e,layerRenderSteps:t}=this;for(let s=0;s<t.length;s++){let r=t[s],i=r.layer;e.isEnabled(i,r.transparent)&&this.renderLayerRenderStep(r,s===0)}}after(){let e=this.sceneTextures;if(this.sceneTexturesCamera&&e?.length){let{renderTarget:t}=this;for(let s=0;s<e.length;s++){let r=mm[e[s]],i=t.getColorBuffer(s+1);this.device.scope.resolve(r).setValue(i),e[s]===Di&&this.sceneTexturesCamera.publishSceneDepthMap(i,this.device.renderVersion)}}for(let t=0;t<this.layerRenderSteps.length;t++){let s=this.layerRenderSteps[t];s.lastCameraUse&&this.scene.fire(Bg,s.cameraComponent)}this.beforePasses.length=0}renderLayerRenderStep(e,t){let{renderer:s,scene:r}=this,i=s.device,{layer:a,transparent:o,cameraComponent:n}=e;if(n){let c=n.gammaCorrection,h=n.toneMapping,d=n.shaderParams.sceneTextures;this.sceneTextures!==void 0&&(n.shaderParams.sceneTextures=this.sceneTextures),this.gammaCorrection!==void 0&&(n.gammaCorrection=this.gammaCorrection),this.toneMapping!==void 0&&(n.toneMapping=this.toneMapping),r.fire(Ug,n,a,o);let f={lightClusters:e.lightClusters},u=n.camera.shaderPassInfo?.index??jr;(!t||!n.camera.fullSizeClearRect)&&(f.clearColor=e.clearColor,f.clearDepth=e.clearDepth,f.clearStencil=e.clearStencil);let m=e.renderTarget??i.backBuffer;s.renderForwardLayer(n.camera,m,a,o,u,f),i.setDrawStates(),i.setAlphaToCoverage(!1),r.fire(kg,n,a,o),this.gammaCorrection!==void 0&&(n.gammaCorrection=c),this.toneMapping!==void 0&&(n.toneMapping=h),this.sceneTextures!==void 0&&(n.shaderParams.sceneTextures=d)}}};var rd=class extends Dt{constructor(e,t,s){super(e),this.renderer=t,this.renderAction=s}execute(){this.renderAction.camera.onPostprocessing()}};var rp=new Ve,$S=[];function KS(l,e){if(l.hasAttachmentOverrides)return l;let t=$S[e]??($S[e]=new Map),s=l.key,r=t.get(s);if(!r){rp.copy(l),rp.setColorWrite(!1,!1,!1,!1),r=l.clone();for(let i=1;i<e;i++)r.setAttachment(i,rp);t.set(s,r)}return r}var qP=new Zr,Jr=new z,ja={drawCalls:[],shaderInstances:[],isNewMaterial:[],clear:function(){this.drawCalls.length=0,this.shaderInstances.length=0,this.isNewMaterial.length=0}};function $P(l){let e=[];for(let t=0;t<l;++t){let s=Math.sqrt(t+.5)/Math.sqrt(l);e.push(s)}return e}function KP(l){let e=[];for(let t=0;t<l;t++){let s=t/l,r=Math.sqrt(s*s);e.push(r)}return e}var Pn=class extends td{_worldClustersDebug=null;debugDrawLimit=null;debugDrawLimitSupported=!1;constructor(e,t){super(e,t);let s=this.device;this._forwardDrawCalls=0,this._materialSwitches=0,this._depthMapTime=0,this._forwardTime=0,this._sortTime=0;let r=s.scope;this.fogColorId=r.resolve("fog_color"),this.fogStartId=r.resolve("fog_start"),this.fogEndId=r.resolve("fog_end"),this.fogDensityId=r.resolve("fog_density"),this.ambientId=r.resolve("light_globalAmbient"),this.skyboxIntensityId=r.resolve("skyboxIntensity"),this.cubeMapRotationMatrixId=r.resolve("cubeMapRotationMatrix"),this.sceneEnvAtlasId=r.resolve("scene_envAtlas"),this.sceneSkyboxId=r.resolve("scene_skybox"),this.pcssDiskSamplesId=r.resolve("pcssDiskSamples[0]"),this.pcssSphereSamplesId=r.resolve("pcssSphereSamples[0]"),this.screenSizeId=r.resolve("screen_size"),this.screenSizeLegacyId=r.resolve("uScreenSize"),this._screenSize=new Float32Array(4),this.fogColor=new Float32Array(3),this.ambientColor=new Float32Array(3),this.pcssDiskSamples=$P(16),this.pcssSphereSamples=KP(16)}destroy(){this._worldClustersDebug?.destroy(),this._worldClustersDebug=null,super.destroy()}dispatchGlobalLights(e){let t=this.ambientColor;if(Jr.linear(e.ambientLight),t[0]=Jr.r,t[1]=Jr.g,t[2]=Jr.b,e.physicalUnits)for(let s=0;s<3;s++)t[s]*=e.ambientLuminance;this.ambientId.setValue(t),this.skyboxIntensityId.setValue(e.physicalUnits?e.skyboxLuminance:e.skyboxIntensity),this.cubeMapRotationMatrixId.setValue(e._skyboxRotationMat3.data),this.sceneEnvAtlasId.setValue(e.envAtlas),this.sceneSkyboxId.setValue(e.skybox)}dispatchLights(e,t){let s=e.slots;for(let r=0;r<s.length;r++)this.getLightSlotUniforms(r).dispatch(s[r],t)}renderForwardPrepareMaterials(e,t,s,r,i,a,o){let n=e.fogParams??this.scene.fog,c=e.shaderParams;c.fog=n.type,c.srgbRenderTarget=t?.isColorBufferSrgb(0)??!1;let h=(p,g,T)=>{ja.drawCalls.push(p),ja.shaderInstances.push(g),ja.isNewMaterial.push(T)};ja.clear();let d=this.device,f=this.scene,u=null,m,_=s.length;for(let p=0;p<_;p++){let g=s[p];if((g.shaderPassMask&1<<a)===0)continue;let T=g.instancingData;if(T&&T.count<=0&&!g.getDrawCommands(e))continue;g.ensureMaterial(d);let S=g.material,x=g._shaderDefs;S&&S===u&&x!==m&&(u=null),S!==u&&(this._materialSwitches++,S._scene=f,S.prepareForRender(d,f));let C=g.getShaderInstance(a,r,f,c,o);h(g,C,S!==u),u=S,m=x}return ja}renderForwardInternal(e,t,s,r,i){let a=t.drawCalls.length;if(a===0)return;let o=this.device,n=i?-1:1,h=e.shaderParams.sceneTextures.length>0?o.renderTarget?.colorBufferCount??1:1,d=e.xrActive&&e.xrViews.length?e.xrViews:null,f=o.xrCurrentViewIndex??-1,u=d&&f>=0?f:0,m=d&&f>=0?f+1:d?d.length:0;for(let _=0;_<a;_++){let p=t.drawCalls[_],g=t.isNewMaterial[_],T=t.shaderInstances[_],S=p.material;if(T.shader.failed)continue;if(g){o.setShader(T.shader,!1),this.setupViewBindGroup(T.shader),S.setParameters(o),this.setupMaterialBindGroup(S),this.alphaTestId.setValue(S.alphaTest);let L=h>1&&!S.sceneTexturesWrite?KS(S.blendState,h):S.blendState;o.setBlendState(L),o.setDepthState(S.depthState),o.setAlphaToCoverage(S.alphaToCoverage)}this.setupCullModeAndFrontFace(e._cullFaces,n,p);let x=p.stencilFront??S.stencilFront,C=p.stencilBack??S.stencilBack;o.setStencilState(x,C),this.needsMaterialOverrideBindGroup(p,S)&&this.setupMaterialOverrideBindGroup(p),p.setParameters(o),o.scope.resolve("meshInstanceId").setValue(p.id);let E=p.mesh;this.setVertexBuffers(o,E),this.setMorphing(o,p.morphInstance),this.setSkinning(o,p);let v=p.instancingData;v&&o.setVertexBuffer(v.vertexBuffer),this.setMeshInstanceMatrices(p,!0);let A=T.shader,D=A.usesMeshInstanceStorage?this.updateStorageSlot(p,A):0;this.setupMeshUniformBuffers(T);let R=p.renderStyle,w=E.indexBuffer[R];r?.(p,_);let M=p.getDrawCommands(e);if(d)for(let P=u;P<m;P++){let L=d[P];o.setViewport(L.viewport.x,L.viewport.y,L.viewport.z,L.viewport.w),this._viewOffsetScratch[0]=this._viewBindGroupOffsets[P],o.setBindGroup(jt,this._viewBindGroups[P],this._viewOffsetScratch);let G=P===u,U=P===m-1;o.draw(E.primitive[R],w,v?.count,M,G,U,D),this._forwardDrawCalls++,p.instancingData&&this._instancedDrawCalls++}else o.draw(E.primitive[R],w,v?.count,M,!0,!0,D),this._forwardDrawCalls++,p.instancingData&&this._instancedDrawCalls++;_<a-1&&!t.isNewMaterial[_+1]&&this.restoreMaterialOverrides(p,S),p._scopeParameters.length>0&&p.restoreReplacedParameters(S)}}renderForward(e,t,s,r,i,a,o,n,c){let h=this.renderForwardPrepareMaterials(e,t,s,r,o,i,c);this.renderForwardInternal(e,h,i,a,n),ja.clear()}renderForwardLayer(e,t,s,r,i,a={}){let{scene:o}=this,n=o.clusteredLightingEnabled;this.setupViewport(e,t);let c,h;if(s){s.sortVisible(e,r);let x=s.getCulledInstances(e);c=r?x.transparent:x.opaque,o.immediate.onPreRenderLayer(s,c,r),this._worldClustersDebug?.onPreRenderLayer(s,c),s.requiresLightCube&&(this.lightCube.update(o.ambientLight,s._lights),this.constantLightCube.setValue(this.lightCube.colors)),h=s.getLightList(n)}else c=a.meshInstances,h=a.lightList??qP;if(n){let x=a.lightClusters??this.worldClustersAllocator.empty;x.activate(),s&&!this.clustersDebugRendered&&o.lighting.debugLayer===s.id&&(this.clustersDebugRendered=!0,this._worldClustersDebug??(this._worldClustersDebug=new Fh),this._worldClustersDebug.render(x,o))}o._activeCamera=e;let d=e.fogParams??this.scene.fog;this.setFogConstants(d);let f=this.setCameraUniforms(e,t),u=a.clearColor??!1,m=a.clearDepth??!1,_=a.clearStencil??!1,p=u||m||_;if(c.length===0&&!p)return;this.dispatchLights(h,e);let g=a.viewUniformFormat??this.getViewUniformFormat(n,h);this.setupViewUniformBuffers(g,f),p&&this.clear(e,u,m,_);let T=!!(e._flipFaces^t?.flipY),S=this._forwardDrawCalls;this.renderForward(e,t,c,h,i,a.drawCallback??null,s,T,g),s&&(s._forwardDrawCalls+=this._forwardDrawCalls-S)}setFogConstants(e){Jr.linear(e.color);let t=this.fogColor;t[0]=Jr.r,t[1]=Jr.g,t[2]=Jr.b,this.fogColorId.setValue(t),this.fogStartId.setValue(e.start),this.fogEndId.setValue(e.end),this.fogDensityId.setValue(e.density)}setSceneConstants(){let e=this.scene;this.dispatchGlobalLights(e);let t=this.device;this._screenSize[0]=t.width,this._screenSize[1]=t.height,this._screenSize[2]=1/t.width,this._screenSize[3]=1/t.height,this.screenSizeId.setValue(this._screenSize),this.screenSizeLegacyId.setValue(this._screenSize),this.pcssDiskSamplesId.setValue(this.pcssDiskSamples),this.pcssSphereSamplesId.setValue(this.pcssSphereSamples)}buildFrameGraph(e,t){let s=this.scene;if(e.reset(),s.clusteredLightingEnabled){let{shadowsEnabled:n,cookiesEnabled:c}=s.lighting;this._renderPassUpdateClustered.update(n,c,this.lights,this.localLights),e.addRenderPass(this._renderPassUpdateClustered)}else this._shadowRendererLocal.buildNonClusteredRenderPasses(e,this.localLights);let r=0,i=!0,a=null,o=t._renderActions;for(let n=r;n<o.length;n++){let c=o[n],{layer:h,camera:d}=c,f=this._isMultiview(d);if(c.useCameraPasses)f&&e.beginMultiView(this.device),d.camera.framePasses.forEach(u=>{e.addRenderPass(u)}),f&&e.endMultiView();else{let u=h.id===it,m=u&&(d.renderSceneColorMap||d.renderSceneDepthMap);i&&(i=!1,r=n,a=c.renderTarget);let _=o[n+1],g=(_?!_.useCameraPasses&&_.layer.id===it:!1)&&(d.renderSceneColorMap||d.renderSceneDepthMap),T=_?_.firstCameraUse&&this.culler.cameraDirShadowLights.has(_.camera.camera):!1;if(!_||_.renderTarget!==a||_.camera!==d||T||g||m){let S=u&&r===n;if(f&&(d.renderSceneColorMap||d.renderSceneDepthMap||c.triggerPostprocess&&d?.onPostprocessing),f&&e.beginMultiView(this.device),S||this.addMainRenderPass(e,t,a,r,n),u){if(d.renderSceneColorMap){let x=d.camera.renderPassColorGrab;x.source=d.renderTarget,e.addRenderPass(x)}d.renderSceneDepthMap&&e.addRenderPass(d.camera.renderPassDepthGrab)}if(c.triggerPostprocess&&d?.onPostprocessing){let x=new rd(this.device,this,c);e.addRenderPass(x)}f&&e.endMultiView(),i=!0}}}}_isMultiview(e){let t=e.camera;return this.device.isWebGPU&&!!t?.xrActive&&t.xrViews.length>=2}addMainRenderPass(e,t,s,r,i){let a=new sd(this.device,t,this.scene,this);a.init(s);let o=t._renderActions;for(let n=r;n<=i;n++)a.addLayerRenderStep(this._layerRenderStepFromRenderAction(o[n]));e.addRenderPass(a)}_layerRenderStepFromRenderAction(e){let t=new Ya(e.camera,e.layer,e.transparent,e.renderTarget);return t.clearColor=e.clearColor,t.clearDepth=e.clearDepth,t.clearStencil=e.clearStencil,t.firstCameraUse=e.firstCameraUse,t.lastCameraUse=e.lastCameraUse,t}update(e){this._worldClustersDebug?.frameUpdate(),this.frameUpdate(),this.shadowRenderer.frameUpdate(),this.scene._updateSkyMesh(),this.updateLayerComposition(e),this.collectLights(e),this.beginFrame(e),this.setSceneConstants(),this.gsplatDirector?.update(e),this.culler.updateLightVisibility(e)}cull(e){this.culler.cullComposition(e),this.gsplatDirector?.updateShadows(),this.gpuUpdate(this.culler.processingMeshInstances),this.culler.consumeOneShotShadows()}};var ip=0,Dn=[],In=new Set;function ZP(l,e){return l.drawOrder-e.drawOrder}function QP(l,e){let t=l._sortKeyForward,s=e._sortKeyForward;return t===s?e.mesh.id-l.mesh.id:s-t}function JP(l,e){return e._sortKeyDynamic-l._sortKeyDynamic}function eD(l,e){return l._sortKeyDynamic-e._sortKeyDynamic}var tD=[null,ZP,QP,JP,eD],ap=class{opaque=[];transparent=[]},gr=class{id;name;_enabled=!0;_refCounter=1;opaqueSortMode=om;transparentSortMode=Zc;customSortCallback=null;customCalculateSortValues=null;_clearColorBuffer=!1;_clearDepthBuffer=!1;_clearStencilBuffer=!1;onEnable;onDisable;_meshInstances=[];_meshInstancesDirty=!1;meshInstancesSet=new Set;_shadowCasters=[];shadowCastersSet=new Set;_visibleInstances=new WeakMap;_lights=[];_lightsSet=new Set;_clusteredLightsSet=new Set;_lightList=new Zr;_lightListDirty=!0;_lightIdHash=0;_lightIdHashDirty=!1;requiresLightCube=!1;cameras=[];camerasSet=new Set;gsplatPlacements=[];gsplatPlacementsSet=new Set;gsplatShadowCasters=[];gsplatShadowCastersSet=new Set;gsplatPlacementsDirty=!0;_dirtyComposition=!1;_shaderVersion=-1;constructor(e={}){e.id!==void 0?(this.id=e.id,ip=Math.max(this.id+1,ip)):this.id=ip++,this.name=e.name,this._enabled=e.enabled??!0,this._refCounter=this._enabled?1:0,this.opaqueSortMode=e.opaqueSortMode??om,this.transparentSortMode=e.transparentSortMode??Zc,this._clearColorBuffer=!!e.clearColorBuffer,this._clearDepthBuffer=!!e.clearDepthBuffer,this._clearStencilBuffer=!!e.clearStencilBuffer,this.onEnable=e.onEnable,this.onDisable=e.onDisable,this._enabled&&this.onEnable&&this.onEnable()}get meshInstances(){return this._meshInstancesDirty&&this._updateMeshInstanceCaches(),this._meshInstances}get shadowCasters(){return this._meshInstancesDirty&&this._updateMeshInstanceCaches(),this._shadowCasters}_updateMeshInstanceCaches(){let e=0;for(let t of this.meshInstancesSet)this._meshInstances[e++]=t;this._meshInstances.length=e,e=0;for(let t of this.shadowCastersSet)this._shadowCasters[e++]=t;this._shadowCasters.length=e,this._meshInstancesDirty=!1}_clearMeshInstanceCaches(){this._meshInstances.length=0,this._shadowCasters.length=0}set enabled(e){e!==this._enabled&&(this._dirtyComposition=!0,this.gsplatPlacementsDirty=!0,this._enabled=e,e?(this.incrementCounter(),this.onEnable&&this.onEnable()):(this.decrementCounter(),this.onDisable&&this.onDisable()))}get enabled(){return this._enabled}set clearColorBuffer(e){this._clearColorBuffer=e,this._dirtyComposition=!0}get clearColorBuffer(){return this._clearColorBuffer}set clearDepthBuffer(e){this._clearDepthBuffer=e,this._dirtyComposition=!0}get clearDepthBuffer(){return this._clearDepthBuffer}set clearStencilBuffer(e){this._clearStencilBuffer=e,this._dirtyComposition=!0}get clearStencilBuffer(){return this._clearStencilBuffer}get hasClusteredLights(){return this._clusteredLightsSet.size>0}get clusteredLightsSet(){return this._clusteredLightsSet}incrementCounter(){this._refCounter===0&&(this._enabled=!0,this.onEnable&&this.onEnable()),this._refCounter++}decrementCounter(){if(this._refCounter===1)this._enabled=!1,this.onDisable&&this.onDisable();else if(this._refCounter===0)return;this._refCounter--}addGSplatPlacement(e){this.gsplatPlacementsSet.has(e)||(this.gsplatPlacements.push(e),this.gsplatPlacementsSet.add(e),this.gsplatPlacementsDirty=!0)}removeGSplatPlacement(e){let t=this.gsplatPlacements.indexOf(e);t>=0&&(this.gsplatPlacements.splice(t,1),this.gsplatPlacementsSet.delete(e),this.gsplatPlacementsDirty=!0)}addGSplatShadowCaster(e){this.gsplatShadowCastersSet.has(e)||(this.gsplatShadowCasters.push(e),this.gsplatShadowCastersSet.add(e),this.gsplatPlacementsDirty=!0)}removeGSplatShadowCaster(e){let t=this.gsplatShadowCasters.indexOf(e);t>=0&&(this.gsplatShadowCasters.splice(t,1),this.gsplatShadowCastersSet.delete(e),this.gsplatPlacementsDirty=!0)}addMeshInstances(e,t){let s=this._meshInstancesDirty?null:this._meshInstances,r=this.meshInstancesSet;In.clear();for(let i=0;i<e.length;i++){let a=e[i];if(!r.has(a)){s?.push(a),r.add(a);let o=a.material;o&&In.add(o)}}if(t||this.addShadowCasters(e),In.size>0){let i=this._shaderVersion;In.forEach(a=>{i>=0&&a._shaderVersion!==i&&(a.getShaderVariant!==Os.prototype.getShaderVariant&&a.clearVariants(),a._shaderVersion=i)}),In.clear()}}removeMeshInstances(e,t){let s=this.meshInstancesSet;for(let r=0;r<e.length;r++){let i=e[r];s.delete(i)&&(this._meshInstancesDirty=!0)}t||this.removeShadowCasters(e),this._meshInstancesDirty&&this._clearMeshInstanceCaches()}addShadowCasters(e){let t=this._meshInstancesDirty?null:this._shadowCasters,s=this.shadowCastersSet;for(let r=0;r<e.length;r++){let i=e[r];i.castShadow&&!s.has(i)&&(s.add(i),t?.push(i))}}removeShadowCasters(e){let t=this.shadowCastersSet;for(let s=0;s<e.length;s++){let r=e[s];t.delete(r)&&(this._meshInstancesDirty=!0)}this._meshInstancesDirty&&this._clearMeshInstanceCaches()}clearMeshInstances(e=!1){this._meshInstances.length=0,this.meshInstancesSet.clear(),e||(this._shadowCasters.length=0,this.shadowCastersSet.clear(),this._meshInstancesDirty=!1)}markLightsDirty(){this._lightIdHashDirty=!0,this._lightListDirty=!0}hasLight(e){return this._lightsSet.has(e)}addLight(e){let t=e.light;this._lightsSet.has(t)||(this._lightsSet.add(t),this._lights.push(t),this.markLightsDirty()),t.type!==te&&this._clusteredLightsSet.add(t)}removeLight(e){let t=e.light;this._lightsSet.has(t)&&(this._lightsSet.delete(t),this._lights.splice(this._lights.indexOf(t),1),this.markLightsDirty()),t.type!==te&&this._clusteredLightsSet.delete(t)}clearLights(){this._lightsSet.forEach(e=>e.removeLayer(this)),this._lightsSet.clear(),this._clusteredLightsSet.clear(),this._lights.length=0,this.markLightsDirty()}getLightList(e=this._lightList.clustered){let t=this._lightList;return(this._lightListDirty||t.clustered!==e)&&(this._lightListDirty=!1,t.update(this._lights,e)),t}evaluateLightHash(e,t,s){let r=0,i=this._lights;for(let a=0;a<i.length;a++){let o=i[a].type!==te;(e&&o||t&&!o)&&Dn.push(s?i[a].id:i[a].key)}return Dn.length>0&&(Dn.sort(),r=ua(Dn),Dn.length=0),r}getLightIdHash(){return this._lightIdHashDirty&&(this._lightIdHashDirty=!1,this._lightIdHash=this.evaluateLightHash(!0,!1,!0)),this._lightIdHash}addCamera(e){this.camerasSet.has(e.camera)||(this.camerasSet.add(e.camera),this.cameras.push(e),this._dirtyComposition=!0)}removeCamera(e){if(this.camerasSet.has(e.camera)){this.camerasSet.delete(e.camera);let t=this.cameras.indexOf(e);this.cameras.splice(t,1),this._dirtyComposition=!0}}clearCameras(){this.cameras.length=0,this.camerasSet.clear(),this._dirtyComposition=!0}_calculateSortDistances(e,t,s){let r=e.length,{x:i,y:a,z:o}=t,{x:n,y:c,z:h}=s;for(let d=0;d<r;d++){let f=e[d],u;if(f.calculateSortDistance)u=f.calculateSortDistance(f,t,s);else{let _=f.aabb.center;u=(_.x-i)*n+(_.y-a)*c+(_.z-o)*h}let m=f._drawBucket*1e9;f._sortKeyDynamic=m+u}}getCulledInstances(e){let t=this._visibleInstances.get(e);return t||(t=new ap,this._visibleInstances.set(e,t)),t}sortVisible(e,t){let s=t?this.transparentSortMode:this.opaqueSortMode;if(s===Fa)return;let r=this.getCulledInstances(e),i=t?r.transparent:r.opaque,a=e.node;if(s===Mg){let o=a.getPosition(),n=a.forward;this.customCalculateSortValues&&this.customCalculateSortValues(i,i.length,o,n),this.customSortCallback&&i.sort(this.customSortCallback)}else{if(s===Zc||s===wg){let o=a.getPosition(),n=a.forward;this._calculateSortDistances(i,o,n)}i.sort(tD[s])}}};var sD=(l,e)=>l.priority-e.priority,wn=l=>l.sort(sD);var id=class{camera=null;constructor(){this.layer=null,this.transparent=!1,this.renderTarget=null,this.clearColor=!1,this.clearDepth=!1,this.clearStencil=!1,this.triggerPostprocess=!1,this.firstCameraUse=!1,this.lastCameraUse=!1,this.useCameraPasses=!1}setupClears(e,t){this.clearColor=e?.clearColorBuffer||t.clearColorBuffer,this.clearDepth=e?.clearDepthBuffer||t.clearDepthBuffer,this.clearStencil=e?.clearStencilBuffer||t.clearStencilBuffer}};var Mn=class extends de{layerList=[];layerIdMap=new Map;layerNameMap=new Map;layerOpaqueIndexMap=new Map;layerTransparentIndexMap=new Map;subLayerList=[];subLayerEnabled=[];cameras=[];camerasSet=new Set;_renderActions=[];_dirty=!1;constructor(e="Untitled"){super(),this.name=e,this._opaqueOrder={},this._transparentOrder={}}markDirty(){this._dirty=!0}_update(){let e=this.layerList.length;if(!this._dirty){for(let t=0;t<e;t++)if(this.layerList[t]._dirtyComposition){this._dirty=!0;break}}if(this._dirty){this._dirty=!1,this.cameras.length=0,this.camerasSet.clear();for(let r=0;r<e;r++){let i=this.layerList[r];i._dirtyComposition=!1;for(let a=0;a<i.cameras.length;a++){let o=i.cameras[a];this.camerasSet.has(o.camera)||(this.camerasSet.add(o.camera),this.cameras.push(o))}}this.cameras.length>1&&wn(this.cameras);let t=[],s=0;this._renderActions.length=0;for(let r=0;r<this.cameras.length;r++){let i=this.cameras[r];if(t.length=0,i.camera.framePasses.length>0){this.addDummyRenderAction(s,i),s++;continue}let a=!0,o=s,n=null,c=!1;for(let h=0;h<e;h++){let d=this.layerList[h];if(d.enabled&&this.subLayerEnabled[h]&&d.cameras.length>0&&i.layers.indexOf(d.id)>=0){t.push(d),!c&&d.id===i.disablePostEffectsLayer&&(c=!0,n&&(n.triggerPostprocess=!0));let u=this.subLayerList[h];n=this.addRenderAction(s,d,u,i,a,c),s++,a=!1}}o<s&&(n.lastCameraUse=!0),!c&&n&&(n.triggerPostprocess=!0),i.renderTarget&&i.postEffectsEnabled&&this.propagateRenderTarget(o-1,i)}this._logRenderActions()}}getNextRenderAction(e){let t=new id;return this._renderActions.push(t),t}addDummyRenderAction(e,t){let s=this.getNextRenderAction(e);s.camera=t,s.useCameraPasses=!0}addRenderAction(e,t,s,r,i,a){let o=t.id!==it?r.renderTarget:null,n=!1,c=this._renderActions;for(let u=e-1;u>=0;u--)if(c[u].camera===r&&c[u].renderTarget===o){n=!0;break}a&&r.postEffectsEnabled&&(o=null);let h=this.getNextRenderAction(e);h.triggerPostprocess=!1,h.layer=t,h.transparent=s,h.camera=r,h.renderTarget=o,h.firstCameraUse=i,h.lastCameraUse=!1;let d=i||!n,f=t.clearColorBuffer||t.clearDepthBuffer||t.clearStencilBuffer;return(d||f)&&h.setupClears(d?r:void 0,t),h}propagateRenderTarget(e,t){for(let s=e;s>=0;s--){let r=this._renderActions[s],i=r.layer;if(r.renderTarget&&i.id!==it)break;if(i.id===it)continue;if(r.useCameraPasses)break;let a=r?.camera.camera;if(a&&(!t.camera.rect.equals(a.rect)||!t.camera.scissorRect.equals(a.scissorRect)))break;r.renderTarget=t.renderTarget}}_logRenderActions(){}_isLayerAdded(e){return this.layerIdMap.get(e.id)===e}_isSublayerAdded(e,t){return(t?this.layerTransparentIndexMap:this.layerOpaqueIndexMap).get(e)!==void 0}push(e){this._isLayerAdded(e)||(this.layerList.push(e),this.layerList.push(e),this._opaqueOrder[e.id]=this.subLayerList.push(!1)-1,this._transparentOrder[e.id]=this.subLayerList.push(!0)-1,this.subLayerEnabled.push(!0),this.subLayerEnabled.push(!0),this._updateLayerMaps(),this._dirty=!0,this.fire("add",e))}insert(e,t){if(this._isLayerAdded(e))return;this.layerList.splice(t,0,e,e),this.subLayerList.splice(t,0,!1,!0);let s=this.layerList.length;this._updateOpaqueOrder(t,s-1),this._updateTransparentOrder(t,s-1),this.subLayerEnabled.splice(t,0,!0,!0),this._updateLayerMaps(),this._dirty=!0,this.fire("add",e)}remove(e){let t=this.layerList.indexOf(e);for(delete this._opaqueOrder[t],delete this._transparentOrder[t];t>=0;)this.layerList.splice(t,1),this.subLayerList.splice(t,1),this.subLayerEnabled.splice(t,1),t=this.layerList.indexOf(e),this._dirty=!0,this.fire("remove",e);let s=this.layerList.length;this._updateOpaqueOrder(0,s-1),this._updateTransparentOrder(0,s-1),this._updateLayerMaps()}pushOpaque(e){this._isSublayerAdded(e,!1)||(this.layerList.push(e),this._opaqueOrder[e.id]=this.subLayerList.push(!1)-1,this.subLayerEnabled.push(!0),this._updateLayerMaps(),this._dirty=!0,this.fire("add",e))}insertOpaque(e,t){if(this._isSublayerAdded(e,!1))return;this.layerList.splice(t,0,e),this.subLayerList.splice(t,0,!1);let s=this.subLayerList.length;this._updateOpaqueOrder(t,s-1),this.subLayerEnabled.splice(t,0,!0),this._updateLayerMaps(),this._dirty=!0,this.fire("add",e)}removeOpaque(e){for(let t=0,s=this.layerList.length;t<s;t++)if(this.layerList[t]===e&&!this.subLayerList[t]){this.layerList.splice(t,1),this.subLayerList.splice(t,1),s--,this._updateOpaqueOrder(t,s-1),this.subLayerEnabled.splice(t,1),this._dirty=!0,this.layerList.indexOf(e)<0&&this.fire("remove",e);break}this._updateLayerMaps()}pushTransparent(e){this._isSublayerAdded(e,!0)||(this.layerList.push(e),this._transparentOrder[e.id]=this.subLayerList.push(!0)-1,this.subLayerEnabled.push(!0),this._updateLayerMaps(),this._dirty=!0,this.fire("add",e))}insertTransparent(e,t){if(this._isSublayerAdded(e,!0))return;this.layerList.splice(t,0,e),this.subLayerList.splice(t,0,!0);let s=this.subLayerList.length;this._updateTransparentOrder(t,s-1),this.subLayerEnabled.splice(t,0,!0),this._updateLayerMaps(),this._dirty=!0,this.fire("add",e)}removeTransparent(e){for(let t=0,s=this.layerList.length;t<s;t++)if(this.layerList[t]===e&&this.subLayerList[t]){this.layerList.splice(t,1),this.subLayerList.splice(t,1),s--,this._updateTransparentOrder(t,s-1),this.subLayerEnabled.splice(t,1),this._dirty=!0,this.layerList.indexOf(e)<0&&this.fire("remove",e);break}this._updateLayerMaps()}getOpaqueIndex(e){return this.layerOpaqueIndexMap.get(e)??-1}getTransparentIndex(e){return this.layerTransparentIndexMap.get(e)??-1}isEnabled(e,t){if(e.enabled){let s=t?this.getTransparentIndex(e):this.getOpaqueIndex(e);if(s>=0)return this.subLayerEnabled[s]}return!1}isSubLayerRenderedByCamera(e,t){let s=this.layerList[e];return s.enabled&&this.subLayerEnabled[e]&&s.camerasSet.has(t)}_updateLayerMaps(){this.layerIdMap.clear(),this.layerNameMap.clear(),this.layerOpaqueIndexMap.clear(),this.layerTransparentIndexMap.clear();for(let e=0;e<this.layerList.length;e++){let t=this.layerList[e];this.layerIdMap.set(t.id,t),this.layerNameMap.set(t.name,t),(this.subLayerList[e]?this.layerTransparentIndexMap:this.layerOpaqueIndexMap).set(t,e)}}getLayerById(e){return this.layerIdMap.get(e)??null}getLayerByName(e){return this.layerNameMap.get(e)??null}_updateOpaqueOrder(e,t){for(let s=e;s<=t;s++)this.subLayerList[s]===!1&&(this._opaqueOrder[this.layerList[s].id]=s)}_updateTransparentOrder(e,t){for(let s=e;s<=t;s++)this.subLayerList[s]===!0&&(this._transparentOrder[this.layerList[s].id]=s)}_sortLayersDescending(e,t,s){let r=-1,i=-1;for(let a=0,o=e.length;a<o;a++){let n=e[a];s.hasOwnProperty(n)&&(r=Math.max(r,s[n]))}for(let a=0,o=t.length;a<o;a++){let n=t[a];s.hasOwnProperty(n)&&(i=Math.max(i,s[n]))}return r===-1&&i!==-1?1:i===-1&&r!==-1?-1:i-r}sortTransparentLayers(e,t){return this._sortLayersDescending(e,t,this._transparentOrder)}sortOpaqueLayers(e,t){return this._sortLayersDescending(e,t,this._opaqueOrder)}};var ad=class{_areaLightsEnabled=!1;_cells=new y(10,3,10);_maxLightsPerCell=255;_maxLights=255;_shadowsEnabled=!0;_shadowType=Ko;_shadowAtlasResolution=2048;_cookiesEnabled=!1;_cookieAtlasResolution=2048;debugLayer;atlasSplit=null;constructor(e,t,s){this._supportsAreaLights=e,this._maxTextureSize=t,this._dirtyLightsFnc=s}applySettings(e){this.shadowsEnabled=e.lightingShadowsEnabled??this.shadowsEnabled,this.cookiesEnabled=e.lightingCookiesEnabled??this.cookiesEnabled,this.areaLightsEnabled=e.lightingAreaLightsEnabled??this.areaLightsEnabled,this.shadowAtlasResolution=e.lightingShadowAtlasResolution??this.shadowAtlasResolution,this.cookieAtlasResolution=e.lightingCookieAtlasResolution??this.cookieAtlasResolution,this.maxLightsPerCell=e.lightingMaxLightsPerCell??this.maxLightsPerCell,this.maxLights=e.lightingMaxLights??this.maxLights,this.shadowType=e.lightingShadowType??this.shadowType,e.lightingCells&&(this.cells=new y(e.lightingCells))}set cells(e){this._cells.copy(e)}get cells(){return this._cells}set maxLightsPerCell(e){this._maxLightsPerCell=O.clamp(e,1,255)}get maxLightsPerCell(){return this._maxLightsPerCell}set maxLights(e){this._maxLights=O.clamp(e,1,Math.min(65535,this._maxTextureSize-1))}get maxLights(){return this._maxLights}set cookieAtlasResolution(e){this._cookieAtlasResolution=O.clamp(e,32,this._maxTextureSize)}get cookieAtlasResolution(){return this._cookieAtlasResolution}set shadowAtlasResolution(e){this._shadowAtlasResolution=O.clamp(e,32,this._maxTextureSize)}get shadowAtlasResolution(){return this._shadowAtlasResolution}set shadowType(e){this._shadowType!==e&&(this._shadowType=e,this._dirtyLightsFnc())}get shadowType(){return this._shadowType}set cookiesEnabled(e){this._cookiesEnabled!==e&&(this._cookiesEnabled=e,this._dirtyLightsFnc())}get cookiesEnabled(){return this._cookiesEnabled}set areaLightsEnabled(e){this._supportsAreaLights&&this._areaLightsEnabled!==e&&(this._areaLightsEnabled=e,this._dirtyLightsFnc())}get areaLightsEnabled(){return this._areaLightsEnabled}set shadowsEnabled(e){this._shadowsEnabled!==e&&(this._shadowsEnabled=e,this._dirtyLightsFnc())}get shadowsEnabled(){return this._shadowsEnabled}};var qa=class{enabled=!1;k=1;invK=1;cornerScale=1;projMat00=1;projMat11=1;maxTheta=Math.PI;_lastT=-1;_lastFov=-1;_lastP00=0;_lastP11=0;update(e,t,s){s.data[15]===1&&(e=0);let r=s.data[0],i=s.data[5];if(e===this._lastT&&t===this._lastFov&&r===this._lastP00&&i===this._lastP11)return;if(this._lastT=e,this._lastFov=t,this._lastP00=r,this._lastP11=i,e<=0){this.enabled=!1,this.k=1,this.invK=1,this.cornerScale=1,this.maxTheta=Math.PI;return}this.enabled=!0;let a=t/180+.15,o=Math.max(1,t/180+.05),n=o*Math.pow(a/o,e);this.k=n,this.invK=1/n,this.cornerScale=1+(Math.SQRT2-1)*e;let c=Math.min(n*Math.PI/2,3.13),h=this.cornerScale,d=Math.atan2(1,r),f=Math.min(d,c-.01);this.projMat00=h/(n*Math.tan(f/n));let u=Math.atan2(1,i),m=Math.min(u,c-.01);this.projMat11=h/(n*Math.tan(m/n)),this.maxTheta=c}};var op=class extends Ls{generateKey(e){let t=e.shaderDesc,s=t.vertexGLSL?$e(t.vertexGLSL):0,r=t.fragmentGLSL?$e(t.fragmentGLSL):0,i=t.vertexWGSL?$e(t.vertexWGSL):0,a=t.fragmentWGSL?$e(t.fragmentWGSL):0,o=Ls.definesHash(e.defines),n=e.shaderChunks?.key??"",c=`${t.uniqueName}_${o}_${s}_${r}_${i}_${a}_${n}`;return e.skin&&(c+="_skin"),e.useInstancing&&(c+="_inst"),e.useMorphPosition&&(c+="_morphp"),e.useMorphNormal&&(c+="_morphn"),e.useMorphTextureBasedInt&&(c+="_morphi"),e.useDualSourceBlending&&(c+="_dualSource"),c}createAttributesDefinition(e,t){let s=t.shaderDesc.attributes,r=s?{...s}:void 0;t.skin&&(r.vertex_boneWeights=Xt,r.vertex_boneIndices=Yt),(t.useMorphPosition||t.useMorphNormal)&&(r.morph_vertex_id=Ar),e.attributes=r}addSharedDefines(e,t){t.skin&&e.set("SKIN",!0),t.useInstancing&&e.set("INSTANCING",!0),(t.useMorphPosition||t.useMorphNormal)&&(e.set("MORPHING",!0),t.useMorphTextureBasedInt&&e.set("MORPHING_INT",!0),t.useMorphPosition&&e.set("MORPHING_POSITION",!0),t.useMorphNormal&&e.set("MORPHING_NORMAL",!0))}createVertexDefinition(e,t,s,r){let i=t.shaderDesc,a=new Map(s);a.set("transformInstancingVS","");let o=new Map(t.defines);this.addSharedDefines(o,t),e.vertexCode=r?i.vertexWGSL:i.vertexGLSL,e.vertexIncludes=a,e.vertexDefines=o}createFragmentDefinition(e,t,s,r){let i=t.shaderDesc,a=new Map(s),o=new Map(t.defines);this.addSharedDefines(o,t),e.fragmentCode=r?i.fragmentWGSL:i.fragmentGLSL,e.fragmentIncludes=a,e.fragmentDefines=o}createShaderDefinition(e,t){let s=t.shaderDesc,r=e.isWebGPU&&!!s.vertexWGSL&&!!s.fragmentWGSL&&(t.shaderChunks?.useWGSL??!0),i={name:`ShaderMaterial-${s.uniqueName}`,shaderLanguage:r?q:ce,fragmentOutputTypes:s.fragmentOutputTypes,useDualSourceBlending:t.useDualSourceBlending,meshUniformBufferFormat:s.meshUniformBufferFormat,meshBindGroupFormat:s.meshBindGroupFormat},a=r?q:ce,o=dr.merge(Ee.get(e,a),t.shaderChunks[a]);return this.createAttributesDefinition(i,t),this.createVertexDefinition(i,t,o,r),this.createFragmentDefinition(i,t,o,r),It.createDefinition(e,i)}},ZS=new op;var st=class extends Os{_shaderDesc;constructor(e){super(),this.sceneTexturesWrite=!1,this.shaderDesc=e}set shaderDesc(e){if(this._shaderDesc=void 0,e&&(this._shaderDesc={uniqueName:e.uniqueName,attributes:e.attributes,fragmentOutputTypes:e.fragmentOutputTypes,vertexGLSL:e.vertexGLSL,fragmentGLSL:e.fragmentGLSL,vertexWGSL:e.vertexWGSL,fragmentWGSL:e.fragmentWGSL},e.vertexCode||e.fragmentCode||e.shaderLanguage)){let t=e.shaderLanguage??ce;t===ce?(this._shaderDesc.vertexGLSL=e.vertexCode,this._shaderDesc.fragmentGLSL=e.fragmentCode):t===q&&(this._shaderDesc.vertexWGSL=e.vertexCode,this._shaderDesc.fragmentWGSL=e.fragmentCode)}this.clearVariants()}get shaderDesc(){return this._shaderDesc}copy(e){return super.copy(e),this.shaderDesc=e.shaderDesc,this}getShaderVariant(e){let{objDefs:t}=e,s=at.get(e.device).getByIndex(e.pass),r={defines:ot.getCoreDefines(this,e),skin:(t&ar)!==0,useInstancing:(t&us)!==0,useMorphPosition:(t&or)!==0,useMorphNormal:(t&nr)!==0,useMorphTextureBasedInt:(t&lr)!==0,pass:e.pass,gamma:e.cameraShaderParams.shaderOutputGamma,toneMapping:e.cameraShaderParams.toneMapping,fog:e.cameraShaderParams.fog,useDualSourceBlending:s.isForward&&this.blendState.usesDualSourceBlending,shaderDesc:this.shaderDesc,shaderChunks:this.shaderChunks},i=new $r(e.viewUniformFormat,e.vertexFormat),a=hr(e.device);return a.register("shader-material",ZS),a.getProgram("shader-material",r,i,this.userId)}};var QS=(l,e)=>{let t=e.length/3,s=l.length/3,r=new y,i=new y,a=new y,o=new y,n=new y,c=new y,h=[];for(let d=0;d<l.length;d++)h[d]=0;for(let d=0;d<t;d++){let f=e[d*3],u=e[d*3+1],m=e[d*3+2];r.set(l[f*3],l[f*3+1],l[f*3+2]),i.set(l[u*3],l[u*3+1],l[u*3+2]),a.set(l[m*3],l[m*3+1],l[m*3+2]),o.sub2(i,r),n.sub2(a,r),c.cross(o,n).normalize(),h[f*3]+=c.x,h[f*3+1]+=c.y,h[f*3+2]+=c.z,h[u*3]+=c.x,h[u*3+1]+=c.y,h[u*3+2]+=c.z,h[m*3]+=c.x,h[m*3+1]+=c.y,h[m*3+2]+=c.z}for(let d=0;d<s;d++){let f=h[d*3],u=h[d*3+1],m=h[d*3+2],_=f*f+u*u+m*m,p=_>0?1/Math.sqrt(_):0;h[d*3]*=p,h[d*3+1]*=p,h[d*3+2]*=p}return h},JS=(l,e,t,s)=>{let r=s.length/3,i=l.length/3,a=new y,o=new y,n=new y,c=new k,h=new k,d=new k,f=new y,u=new y,m=new Float32Array(i*3),_=new Float32Array(i*3),p=[];for(let C=0;C<r;C++){let E=s[C*3],v=s[C*3+1],A=s[C*3+2];a.set(l[E*3],l[E*3+1],l[E*3+2]),o.set(l[v*3],l[v*3+1],l[v*3+2]),n.set(l[A*3],l[A*3+1],l[A*3+2]),c.set(t[E*2],t[E*2+1]),h.set(t[v*2],t[v*2+1]),d.set(t[A*2],t[A*2+1]);let D=o.x-a.x,R=n.x-a.x,w=o.y-a.y,M=n.y-a.y,P=o.z-a.z,L=n.z-a.z,G=h.x-c.x,U=d.x-c.x,F=h.y-c.y,Y=d.y-c.y,K=G*Y-U*F;if(K===0)f.set(0,1,0),u.set(1,0,0);else{let W=1/K;f.set((Y*D-F*R)*W,(Y*w-F*M)*W,(Y*P-F*L)*W),u.set((G*R-U*D)*W,(G*M-U*w)*W,(G*L-U*P)*W)}m[E*3+0]+=f.x,m[E*3+1]+=f.y,m[E*3+2]+=f.z,m[v*3+0]+=f.x,m[v*3+1]+=f.y,m[v*3+2]+=f.z,m[A*3+0]+=f.x,m[A*3+1]+=f.y,m[A*3+2]+=f.z,_[E*3+0]+=u.x,_[E*3+1]+=u.y,_[E*3+2]+=u.z,_[v*3+0]+=u.x,_[v*3+1]+=u.y,_[v*3+2]+=u.z,_[A*3+0]+=u.x,_[A*3+1]+=u.y,_[A*3+2]+=u.z}let g=new y,T=new y,S=new y,x=new y;for(let C=0;C<i;C++){S.set(e[C*3],e[C*3+1],e[C*3+2]),g.set(m[C*3],m[C*3+1],m[C*3+2]),T.set(_[C*3],_[C*3+1],_[C*3+2]);let E=S.dot(g);x.copy(S).mulScalar(E),x.sub2(g,x).normalize(),p[C*4]=x.x,p[C*4+1]=x.y,p[C*4+2]=x.z,x.cross(S,g),p[C*4+3]=x.dot(T)<0?-1:1}return p};var $a=class{positions;normals;colors;uvs;uvs1;blendIndices;blendWeights;tangents;indices;calculateNormals(){this.normals=QS(this.positions,this.indices)}calculateTangents(){this.tangents=JS(this.positions,this.normals,this.uvs,this.indices)}};var np=8/64,eT=1-np*2,Ln=class extends $a{constructor(e={}){super();let t=e.halfExtents??new y(.5,.5,.5),s=e.widthSegments??1,r=e.lengthSegments??1,i=e.heightSegments??1,a=e.yOffset??0,o=-t.y+a,n=t.y+a,c=[new y(-t.x,o,t.z),new y(t.x,o,t.z),new y(t.x,n,t.z),new y(-t.x,n,t.z),new y(t.x,o,-t.z),new y(-t.x,o,-t.z),new y(-t.x,n,-t.z),new y(t.x,n,-t.z)],h=[[0,1,3],[4,5,7],[3,2,6],[1,0,4],[1,4,2],[5,0,6]],d=[[0,0,1],[0,0,-1],[0,1,0],[0,-1,0],[1,0,0],[-1,0,0]],f={FRONT:0,BACK:1,TOP:2,BOTTOM:3,RIGHT:4,LEFT:5},u=[],m=[],_=[],p=[],g=[],T=0,S=(x,C,E)=>{let v=new y,A=new y,D=new y,R=new y;for(let w=0;w<=C;w++)for(let M=0;M<=E;M++){v.lerp(c[h[x][0]],c[h[x][1]],w/C),A.lerp(c[h[x][0]],c[h[x][2]],M/E),D.sub2(A,c[h[x][0]]),R.add2(v,D);let P=w/C,L=M/E;u.push(R.x,R.y,R.z),m.push(d[x][0],d[x][1],d[x][2]),_.push(P,1-L),P=P*eT+np,L=L*eT+np,P/=3,L/=3,P+=x%3/3,L+=Math.floor(x/3)/3,p.push(P,1-L),w<C&&M<E&&(g.push(T+E+1,T+1,T),g.push(T+E+1,T+E+2,T+1)),T++}};S(f.FRONT,s,i),S(f.BACK,s,i),S(f.TOP,s,r),S(f.BOTTOM,s,r),S(f.RIGHT,r,i),S(f.LEFT,r,i),this.positions=u,this.normals=m,this.uvs=_,this.uvs1=p,this.indices=g,e.calculateTangents&&this.calculateTangents()}};var od=class extends $a{constructor(e={}){super();let t=e.radius??.5,s=e.latitudeBands??16,r=e.longitudeBands??16,i=[],a=[],o=[],n=[];for(let c=0;c<=s;c++){let h=c*Math.PI/s,d=Math.sin(h),f=Math.cos(h),u=0;c===0?u=.5/r:c===s&&(u=-.5/r);for(let m=0;m<=r;m++){let _=m*2*Math.PI/r-Math.PI/2,p=Math.sin(_),T=Math.cos(_)*d,S=f,x=p*d,C=1-m/r+u,E=1-c/s;i.push(T*t,S*t,x*t),a.push(T,S,x),o.push(C,1-E)}}for(let c=0;c<s;++c)for(let h=0;h<r;++h){let d=c*(r+1)+h,f=d+r+1;c!==0&&n.push(d+1,f,d),c!==s-1&&n.push(d+1,f+1,f)}this.positions=i,this.normals=a,this.uvs=o,this.uvs1=o,this.indices=n,e.calculateTangents&&this.calculateTangents()}};var nd=class extends od{constructor(e={}){let s=e.latitudeBands??16,r=e.longitudeBands??16;super({radius:.5,latitudeBands:s,longitudeBands:r});let i=.1,a=.95,o=a*a,n=this.positions;for(let c=0;c<n.length;c+=3){let h=n[c]/.5,d=n[c+1]/.5,f=n[c+2]/.5;d<0&&(d*=.3,h*h+f*f<o&&(d=-i)),d+=i,d*=.5,n[c+1]=d}}};var ld=class l{static create(e,t){switch(t){case bg:return l.box(e);case Fg:return l.dome(e)}return l.infinite(e)}static infinite(e){return ts.fromGeometry(e,new Ln(e))}static box(e){return ts.fromGeometry(e,new Ln({yOffset:.5}))}static dome(e){let t=new nd({latitudeBands:50,longitudeBands:50});return t.normals=void 0,t.uvs=void 0,ts.fromGeometry(e,t)}};var cd=class{meshInstance=null;_depthWrite=!1;constructor(e,t,s,r,i){let a=new st({uniqueName:"SkyMaterial",vertexGLSL:Ee.get(e,ce).get("skyboxVS"),fragmentGLSL:Ee.get(e,ce).get("skyboxPS"),vertexWGSL:Ee.get(e,q).get("skyboxVS"),fragmentWGSL:Ee.get(e,q).get("skyboxPS"),attributes:{aPosition:le}});a.setDefine("{SKYBOX_DECODE_FNC}",zt.decodeFunc(r.encoding)),i!==qr&&a.setDefine("SKYMESH",""),r.cubemap&&a.setDefine("SKY_CUBEMAP",""),a.setParameter("skyboxHighlightMultiplier",t.skyboxHighlightMultiplier),r.cubemap?a.setParameter("texture_cubeMap",r):(a.setParameter("texture_envAtlas",r),a.setParameter("mipLevel",t.skyboxMip)),a.cull=2,a.depthWrite=this._depthWrite;let o=t.layers.getLayerById(Aa);if(o){let n=ld.create(e,i),c=new nt(n,a,s);this.meshInstance=c,c.cull=!1,c.pick=!1,o.addMeshInstances([c]),this.skyLayer=o}}destroy(){this.meshInstance&&(this.skyLayer&&this.skyLayer.removeMeshInstances([this.meshInstance]),this.meshInstance.destroy(),this.meshInstance=null)}set depthWrite(e){if(this._depthWrite=e,this.meshInstance){let t=this.meshInstance.material;t.depthWrite=e,t.sceneTexturesWrite=e&&t.getDefine("SKYMESH")}}get depthWrite(){return this._depthWrite}};var hd=class{_type=qr;_center=new y(0,1,0);skyMesh=null;_depthWrite=!1;_fisheye=0;_fisheyeProj=null;node=new wt("SkyMeshNode");constructor(e){this.device=e.device,this.scene=e,this.center=new y(0,1,0),this.centerArray=new Float32Array(3),this.projectedSkydomeCenterId=this.device.scope.resolve("projectedSkydomeCenter"),this._preRenderEvt=e.on("prerender",this._onPreRender,this)}destroy(){this._preRenderEvt.off(),this.resetSkyMesh()}applySettings(e){this.type=e.skyType??qr,this.node.setLocalPosition(new y(e.skyMeshPosition??[0,0,0])),this.node.setLocalEulerAngles(new y(e.skyMeshRotation??[0,0,0])),this.node.setLocalScale(new y(e.skyMeshScale??[1,1,1])),e.skyCenter&&(this._center=new y(e.skyCenter))}set type(e){this._type!==e&&(this._type=e,this.scene.updateShaders=!0,this.updateSkyMesh())}get type(){return this._type}set center(e){this._center.copy(e)}get center(){return this._center}set depthWrite(e){this._depthWrite!==e&&(this._depthWrite=e,this.skyMesh&&(this.skyMesh.depthWrite=e))}get depthWrite(){return this._depthWrite}set fisheye(e){if(this._fisheye!==e){let t=this._fisheye>0;this._fisheye=e;let s=e>0;t!==s&&(this._fisheyeProj??(this._fisheyeProj=new qa),this._type===qr&&this._setFisheyeDefine(s))}}get fisheye(){return this._fisheye}updateSkyMesh(){let e=this.scene._getSkyboxTex();e&&(this.resetSkyMesh(),this.skyMesh=new cd(this.device,this.scene,this.node,e,this.type),this.skyMesh.depthWrite=this._depthWrite,this._fisheye>0&&this.type===qr&&this._setFisheyeDefine(!0),this.scene.fire("set:skybox",e))}resetSkyMesh(){this.skyMesh?.destroy(),this.skyMesh=null}update(){if(this.type!==qr){let{center:e,centerArray:t}=this,s=new y;this.node.getWorldTransform().transformPoint(e,s),t[0]=s.x,t[1]=s.y,t[2]=s.z,this.projectedSkydomeCenterId.setValue(t)}}_setFisheyeDefine(e){if(this.skyMesh?.meshInstance){let t=this.skyMesh.meshInstance.material;t.setDefine("SKY_FISHEYE",e),t.update()}}_onPreRender(e){if(this._fisheye>0&&this._fisheyeProj&&this.skyMesh?.meshInstance){let t=e.camera,s=this._fisheyeProj;s.update(this._fisheye,t.fov,t.projectionMatrix);let r=this.skyMesh.meshInstance.material;r.setParameter("fisheye_k",s.k),r.setParameter("fisheye_invK",s.invK),r.setParameter("fisheye_projMat00",s.projMat00),r.setParameter("fisheye_projMat11",s.projMat11)}}};var dd=new wt;dd.worldTransform=N.IDENTITY;dd._dirtyWorld=dd._dirtyNormal=!1;var lp=256,iD=100,fd=class{_positions=new Float32Array(0);_colors=new Float32Array(0);_vertexCount=0;_capacity=0;_peakVertexCount=0;_framesSinceHighUse=0;constructor(e,t,s){this.material=t,this.layer=s,this.mesh=new ts(e),this.meshInstance=null}_reserve(e){let t=this._vertexCount+e;if(t<=this._capacity)return;let s=Math.max(this._capacity,lp);for(;s<t;)s*=2;this._setCapacity(s)}_setCapacity(e){let t=new Float32Array(e*3),s=new Float32Array(e*4),r=Math.min(this._vertexCount,e);r>0&&(t.set(this._positions.subarray(0,r*3)),s.set(this._colors.subarray(0,r*4))),this._positions=t,this._colors=s,this._capacity=e}allocate(e){this._reserve(e);let t=this._vertexCount;return this._vertexCount+=e,t}_writeUniformColor(e,t,s){let r=this._colors,{r:i,g:a,b:o,a:n}=e,c=t*4;for(let h=0;h<s;h++)r[c++]=i,r[c++]=a,r[c++]=o,r[c++]=n}addLines(e,t){let s=e.length,r=this._vertexCount;this._reserve(s);let i=this._positions,a=r*3;for(let o=0;o<s;o++){let n=e[o];i[a++]=n.x,i[a++]=n.y,i[a++]=n.z}if(t.length){let o=this._colors,n=r*4;for(let c=0;c<s;c++){let h=t[c];o[n++]=h.r,o[n++]=h.g,o[n++]=h.b,o[n++]=h.a}}else this._writeUniformColor(t,r,s);this._vertexCount+=s}addLinesArrays(e,t){let s=e.length,r=s/3,i=this._vertexCount;this._reserve(r);let a=this._positions,o=i*3;for(let n=0;n<s;n++)a[o++]=e[n];if(t.length){let n=this._colors,c=r*4,h=i*4;for(let d=0;d<c;d++)n[h++]=t[d]}else this._writeUniformColor(t,i,r);this._vertexCount+=r}onPreRender(e,t){this._vertexCount>0&&this.material.transparent===t&&(this.mesh.setPositions(this._positions,3,this._vertexCount),this.mesh.setColors(this._colors,4,this._vertexCount),this.mesh.update(wo,!1),this.meshInstance||(this.meshInstance=new nt(this.mesh,this.material,dd),this.meshInstance.cull=!1),e.push(this.meshInstance))}clear(){if(this._vertexCount*2>this._capacity?(this._framesSinceHighUse=0,this._peakVertexCount=0):(this._framesSinceHighUse++,this._peakVertexCount=Math.max(this._peakVertexCount,this._vertexCount)),this._vertexCount=0,this._framesSinceHighUse>=iD&&this._capacity>lp){let e=lp;for(;e<this._peakVertexCount;)e*=2;e<this._capacity&&this._setCapacity(e),this._peakVertexCount=0,this._framesSinceHighUse=0}}};var ud=class{constructor(e){this.device=e,this.map=new Map}getBatch(e,t){let s=this.map.get(e);return s||(s=new fd(this.device,e,t),this.map.set(e,s)),s}onPreRender(e,t){this.map.forEach(s=>{s.onPreRender(e,t)})}clear(){this.map.forEach(e=>e.clear())}};var md=class{_positions=null;_colors=null;_cursor=0;_end=0;_r=1;_g=1;_b=1;_a=1;reset(e,t,s,r,i){this._positions=e,this._colors=t,this._cursor=s,this._end=s+r,this.setColor(i)}setColor(e){this._r=e.r,this._g=e.g,this._b=e.b,this._a=e.a}get filled(){return this._cursor===this._end}get positions(){return this._positions}get colors(){return this._colors}set cursor(e){this._cursor=e}get cursor(){return this._cursor}get end(){return this._end}segment(e,t,s,r,i,a){let o=this._positions,n=this._colors,c=this._cursor,h=c*3;o[h++]=e,o[h++]=t,o[h++]=s,o[h++]=r,o[h++]=i,o[h]=a;let d=this._r,f=this._g,u=this._b,m=this._a,_=c*4;n[_++]=d,n[_++]=f,n[_++]=u,n[_++]=m,n[_++]=d,n[_++]=f,n[_++]=u,n[_]=m,this._cursor=c+2}vertex(e,t,s,r,i,a,o){let n=this._cursor,c=n*3,h=this._positions;h[c++]=e,h[c++]=t,h[c]=s;let d=n*4,f=this._colors;f[d++]=r,f[d++]=i,f[d++]=a,f[d]=o,this._cursor=n+1}};var rs=[],Ka=new y,pd=class{constructor(e){this.device=e,this.cubeLocalPos=null,this.cubeWorldPos=null,this.batchesMap=new Map,this.allBatches=new Set,this.lineWriter=new md,this._materialDepth=null,this._materialNoDepth=null}createMaterial(e){let t=new st({uniqueName:"ImmediateLine",vertexGLSL:Ee.get(this.device,ce).get("immediateLineVS"),fragmentGLSL:Ee.get(this.device,ce).get("immediateLinePS"),vertexWGSL:Ee.get(this.device,q).get("immediateLineVS"),fragmentWGSL:Ee.get(this.device,q).get("immediateLinePS"),attributes:{vertex_position:le,vertex_color:gt}});return t.blendType=va,t.depthTest=e,t.update(),t}get materialDepth(){return this._materialDepth||(this._materialDepth=this.createMaterial(!0)),this._materialDepth}get materialNoDepth(){return this._materialNoDepth||(this._materialNoDepth=this.createMaterial(!1)),this._materialNoDepth}getBatch(e,t){let s=this.batchesMap.get(e);s||(s=new ud(this.device),this.batchesMap.set(e,s)),this.allBatches.add(s);let r=t?this.materialDepth:this.materialNoDepth;return s.getBatch(r,e)}allocateLines(e,t,s,r){let i=this.lineWriter,a=this.getBatch(r,s),o=a.allocate(e);return i.reset(a._positions,a._colors,o,e,t),i}drawWireAlignedBox(e,t,s,r,i,a){if(a){let n=(c,h,d)=>{Ka.set(c,h,d),a.transformPoint(Ka,Ka),rs.push(Ka.x,Ka.y,Ka.z)};n(e.x,e.y,e.z),n(e.x,t.y,e.z),n(e.x,t.y,e.z),n(t.x,t.y,e.z),n(t.x,t.y,e.z),n(t.x,e.y,e.z),n(t.x,e.y,e.z),n(e.x,e.y,e.z),n(e.x,e.y,t.z),n(e.x,t.y,t.z),n(e.x,t.y,t.z),n(t.x,t.y,t.z),n(t.x,t.y,t.z),n(t.x,e.y,t.z),n(t.x,e.y,t.z),n(e.x,e.y,t.z),n(e.x,e.y,e.z),n(e.x,e.y,t.z),n(e.x,t.y,e.z),n(e.x,t.y,t.z),n(t.x,t.y,e.z),n(t.x,t.y,t.z),n(t.x,e.y,e.z),n(t.x,e.y,t.z)}else rs.push(e.x,e.y,e.z,e.x,t.y,e.z,e.x,t.y,e.z,t.x,t.y,e.z,t.x,t.y,e.z,t.x,e.y,e.z,t.x,e.y,e.z,e.x,e.y,e.z,e.x,e.y,t.z,e.x,t.y,t.z,e.x,t.y,t.z,t.x,t.y,t.z,t.x,t.y,t.z,t.x,e.y,t.z,t.x,e.y,t.z,e.x,e.y,t.z,e.x,e.y,e.z,e.x,e.y,t.z,e.x,t.y,e.z,e.x,t.y,t.z,t.x,t.y,e.z,t.x,t.y,t.z,t.x,e.y,e.z,t.x,e.y,t.z);this.getBatch(i,r).addLinesArrays(rs,s),rs.length=0}drawWireSphere(e,t,s,r,i,a){let o=2*Math.PI/r,n=0;for(let h=0;h<r;h++){let d=Math.sin(n),f=Math.cos(n);n+=o;let u=Math.sin(n),m=Math.cos(n);rs.push(e.x+t*d,e.y,e.z+t*f),rs.push(e.x+t*u,e.y,e.z+t*m),rs.push(e.x+t*d,e.y+t*f,e.z),rs.push(e.x+t*u,e.y+t*m,e.z),rs.push(e.x,e.y+t*d,e.z+t*f),rs.push(e.x,e.y+t*u,e.z+t*m)}this.getBatch(a,i).addLinesArrays(rs,s),rs.length=0}onPreRenderLayer(e,t,s){this.batchesMap.forEach((r,i)=>{i===e&&r.onPreRender(t,s)})}onPostRender(){this.allBatches.forEach(e=>e.clear()),this.allBatches.clear()}};var _d=class{type=Is;color=new z(0,0,0);density=0;start=1;end=1e3};var gd=class extends de{static EVENT_SETLAYERS="set:layers";static EVENT_SETSKYBOX="set:skybox";static EVENT_PRERENDER="prerender";static EVENT_POSTRENDER="postrender";static EVENT_PRERENDER_LAYER="prerender:layer";static EVENT_POSTRENDER_LAYER="postrender:layer";static EVENT_PRECULL="precull";static EVENT_POSTCULL="postcull";ambientBake=!1;ambientBakeOcclusionBrightness=0;ambientBakeOcclusionContrast=0;ambientLight=new z(0,0,0);ambientLuminance=0;exposure=1;lightmapSizeMultiplier=1;lightmapMaxResolution=2048;lightmapMode=Dg;lightmapFilterEnabled=!1;lightmapHDR=!1;root=null;physicalUnits=!1;_envAtlas=null;_skyboxCubeMap=null;_fogParams=new _d;constructor(e){super(),this.device=e,this._gravity=new y(0,-9.8,0),this._layers=null,this._prefilteredCubemaps=[],this._internalEnvAtlas=null,this._skyboxIntensity=1,this._skyboxLuminance=0,this._skyboxMip=0,this._skyboxHighlightMultiplier=1,this._skyboxRotationShaderInclude=!1,this._skyboxRotation=new fe,this._skyboxRotationMat3=new Ss,this._skyboxRotationMat4=new N,this._ambientBakeNumSamples=1,this._ambientBakeSpherePart=.4,this._lightmapFilterRange=10,this._lightmapFilterSmoothness=.2,this._clusteredLightingEnabled=!0,this._lightingParams=new ad(this.device.supportsAreaLights,this.device.maxTextureSize,()=>{this.updateShaders=!0}),this.gsplatCentersEnabled=!0,this._gsplatParams=null,this._sky=new hd(this),this._stats={meshInstances:0,lights:0,dynamicLights:0,bakedLights:0,updateShadersTime:0},this.updateShaders=!0,this._shaderVersion=0,this.immediate=new pd(this.device)}get defaultDrawLayer(){return this.layers.getLayerById(Ra)}set ambientBakeNumSamples(e){this._ambientBakeNumSamples=O.clamp(Math.floor(e),1,255)}get ambientBakeNumSamples(){return this._ambientBakeNumSamples}set ambientBakeSpherePart(e){this._ambientBakeSpherePart=O.clamp(e,.001,1)}get ambientBakeSpherePart(){return this._ambientBakeSpherePart}set clusteredLightingEnabled(e){if(!(this.device.isWebGPU&&!e)){if(!this._clusteredLightingEnabled&&e){console.error("Turning on disabled clustered lighting is not currently supported");return}this._clusteredLightingEnabled=e}}get clusteredLightingEnabled(){return this._clusteredLightingEnabled}set envAtlas(e){e!==this._envAtlas&&(this._envAtlas=e,e&&(e.addressU=1,e.addressV=1,e.minFilter=1,e.magFilter=1,e.mipmaps=!1),this._prefilteredCubemaps=[],this._internalEnvAtlas&&(this._internalEnvAtlas.destroy(),this._internalEnvAtlas=null),this._resetSkyMesh())}get envAtlas(){return this._envAtlas}set layers(e){let t=this._layers;this._layers=e,this.fire("set:layers",t,e)}get layers(){return this._layers}get sky(){return this._sky}get lighting(){return this._lightingParams}get gsplat(){return this._gsplatParams}getGsplatParams(){return this._gsplatParams}setGsplatParams(e){this._gsplatParams=e}get fog(){return this._fogParams}set lightmapFilterRange(e){this._lightmapFilterRange=Math.max(e,.001)}get lightmapFilterRange(){return this._lightmapFilterRange}set lightmapFilterSmoothness(e){this._lightmapFilterSmoothness=Math.max(e,.001)}get lightmapFilterSmoothness(){return this._lightmapFilterSmoothness}set prefilteredCubemaps(e){e=e||[];let t=this._prefilteredCubemaps;(t.length!==e.length||t.some((r,i)=>r!==e[i]))&&(e.length===6&&e.every(i=>!!i)?(this._internalEnvAtlas=Wa.generatePrefilteredAtlas(e,{target:this._internalEnvAtlas}),this._envAtlas=this._internalEnvAtlas):(this._internalEnvAtlas&&(this._internalEnvAtlas.destroy(),this._internalEnvAtlas=null),this._envAtlas=null),this._prefilteredCubemaps=e.slice(),this._resetSkyMesh())}get prefilteredCubemaps(){return this._prefilteredCubemaps}set skybox(e){e!==this._skyboxCubeMap&&(this._skyboxCubeMap=e,this._resetSkyMesh())}get skybox(){return this._skyboxCubeMap}set skyboxIntensity(e){e!==this._skyboxIntensity&&(this._skyboxIntensity=e,this._resetSkyMesh())}get skyboxIntensity(){return this._skyboxIntensity}set skyboxLuminance(e){e!==this._skyboxLuminance&&(this._skyboxLuminance=e,this._resetSkyMesh())}get skyboxLuminance(){return this._skyboxLuminance}set skyboxMip(e){e!==this._skyboxMip&&(this._skyboxMip=e,this._resetSkyMesh())}get skyboxMip(){return this._skyboxMip}set skyboxHighlightMultiplier(e){e!==this._skyboxHighlightMultiplier&&(this._skyboxHighlightMultiplier=e,this._resetSkyMesh())}get skyboxHighlightMultiplier(){return this._skyboxHighlightMultiplier}set skyboxRotation(e){if(!this._skyboxRotation.equals(e)){let t=e.equals(fe.IDENTITY);this._skyboxRotation.copy(e),t?this._skyboxRotationMat3.setIdentity():(this._skyboxRotationMat4.setTRS(y.ZERO,e,y.ONE),this._skyboxRotationMat3.invertMat4(this._skyboxRotationMat4)),!this._skyboxRotationShaderInclude&&!t&&(this._skyboxRotationShaderInclude=!0,this._resetSkyMesh())}}get skyboxRotation(){return this._skyboxRotation}destroy(){this._sky.destroy(),this.root=null,this.off()}drawLine(e,t,s=z.WHITE,r=!0,i=this.defaultDrawLayer){this.immediate.getBatch(i,r).addLines([e,t],[s,s])}drawLines(e,t,s=!0,r=this.defaultDrawLayer){this.immediate.getBatch(r,s).addLines(e,t)}drawLineArrays(e,t,s=!0,r=this.defaultDrawLayer){this.immediate.getBatch(r,s).addLinesArrays(e,t)}applySettings(e){let t=e.physics,s=e.render;this._gravity.set(t.gravity[0],t.gravity[1],t.gravity[2]),this.ambientLight.set(s.global_ambient[0],s.global_ambient[1],s.global_ambient[2]),this.ambientLuminance=s.ambientLuminance,this.fog.type=s.fog,this.fog.color.set(s.fog_color[0],s.fog_color[1],s.fog_color[2]),this.fog.start=s.fog_start,this.fog.end=s.fog_end,this.fog.density=s.fog_density,this.lightmapSizeMultiplier=s.lightmapSizeMultiplier,this.lightmapMaxResolution=s.lightmapMaxResolution,this.lightmapMode=s.lightmapMode,this.exposure=s.exposure,this._skyboxIntensity=s.skyboxIntensity??1,this._skyboxLuminance=s.skyboxLuminance??2e4,this._skyboxMip=s.skyboxMip??0,s.skyboxRotation&&(this.skyboxRotation=new fe().setFromEulerAngles(s.skyboxRotation[0],s.skyboxRotation[1],s.skyboxRotation[2])),this.sky.applySettings(s),this.clusteredLightingEnabled=s.clusteredLightingEnabled??!1,this.lighting.applySettings(s),this.getGsplatParams()?.applySettings(s),["lightmapFilterEnabled","lightmapFilterRange","lightmapFilterSmoothness","ambientBake","ambientBakeNumSamples","ambientBakeSpherePart","ambientBakeOcclusionBrightness","ambientBakeOcclusionContrast"].forEach(r=>{s.hasOwnProperty(r)&&(this[r]=s[r])}),this._resetSkyMesh()}_getSkyboxTex(){let e=this._prefilteredCubemaps;return this._skyboxMip?e[[0,1,3,4,5,6][this._skyboxMip]]||this._envAtlas||e[0]||this._skyboxCubeMap:this._skyboxCubeMap||e[0]||this._envAtlas}_updateSkyMesh(){this.sky.skyMesh||this.sky.updateSkyMesh(),this.sky.update()}_resetSkyMesh(){this.sky.resetSkyMesh(),this.updateShaders=!0}setSkybox(e){e?(this.skybox=e[0]||null,e[1]&&!e[1].cubemap?this.envAtlas=e[1]:this.prefilteredCubemaps=e.slice(1)):(this.skybox=null,this.envAtlas=null)}get lightmapPixelFormat(){return this.lightmapHDR&&this.device.getRenderableHdrFormat()||Re}get defaultMaterial(){return Va(this.device)}set fogColor(e){this.fog.color=e}get fogColor(){return this.fog.color}set fogEnd(e){this.fog.end=e}get fogEnd(){return this.fog.end}set fogStart(e){this.fog.start=e}get fogStart(){return this.fog.start}set fogDensity(e){this.fog.density=e}get fogDensity(){return this.fog.density}set skyboxPrefiltered128(e){this._prefilteredCubemaps[0]=e,this.updateShaders=!0}get skyboxPrefiltered128(){return this._prefilteredCubemaps[0]}set skyboxPrefiltered64(e){this._prefilteredCubemaps[1]=e,this.updateShaders=!0}get skyboxPrefiltered64(){return this._prefilteredCubemaps[1]}set skyboxPrefiltered32(e){this._prefilteredCubemaps[2]=e,this.updateShaders=!0}get skyboxPrefiltered32(){return this._prefilteredCubemaps[2]}set skyboxPrefiltered16(e){this._prefilteredCubemaps[3]=e,this.updateShaders=!0}get skyboxPrefiltered16(){return this._prefilteredCubemaps[3]}set skyboxPrefiltered8(e){this._prefilteredCubemaps[4]=e,this.updateShaders=!0}get skyboxPrefiltered8(){return this._prefilteredCubemaps[4]}set skyboxPrefiltered4(e){this._prefilteredCubemaps[5]=e,this.updateShaders=!0}get skyboxPrefiltered4(){return this._prefilteredCubemaps[5]}get models(){return this._models??(this._models=[]),this._models}};var tT=16,sT=16,rT=tT*sT,Sd=2*rT,Za=class{device;passes=[];_uniformBufferFormat=null;_bindGroupFormat=null;_scanShader=null;_addBlockShader=null;constructor(e){this.device=e,this._createFormatsAndShaders()}destroy(){this.destroyPasses(),this._scanShader?.destroy(),this._addBlockShader?.destroy(),this._bindGroupFormat?.destroy(),this._scanShader=null,this._addBlockShader=null,this._bindGroupFormat=null,this._uniformBufferFormat=null}_createFormatsAndShaders(){this._uniformBufferFormat=new Te(this.device,[new I("elementCount",X)]),this._bindGroupFormat=new Ae(this.device,[new V("items",B,!1),new V("blockSums",B,!1),new De("uniforms",B)]),this._scanShader=this._createShader("PrefixSumScan","reduce_downsweep"),this._addBlockShader=this._createShader("PrefixSumAddBlock","add_block_sums")}createPassesRecursive(e,t){let s=Math.ceil(t/Sd),{x:r,y:i}=this.findOptimalDispatchSize(s),a=new re(this.device,s*4),o=new Ie(this.device,this._scanShader,"PrefixSumScan");o.setParameter("items",e),o.setParameter("blockSums",a);let n={scanCompute:o,addBlockCompute:null,blockSumBuffer:a,dispatchX:r,dispatchY:i,count:t,allocatedCount:t};if(this.passes.push(n),s>1){this.createPassesRecursive(a,s);let c=new Ie(this.device,this._addBlockShader,"PrefixSumAddBlock");c.setParameter("items",e),c.setParameter("blockSums",a),n.addBlockCompute=c}}_createShader(e,t){let s=new Map;return s.set("{WORKGROUP_SIZE_X}",tT),s.set("{WORKGROUP_SIZE_Y}",sT),s.set("{THREADS_PER_WORKGROUP}",rT),s.set("{ITEMS_PER_WORKGROUP}",Sd),new be(this.device,{name:e,shaderLanguage:q,cshader:"",cdefines:s,computeEntryPoint:t,computeBindGroupFormat:this._bindGroupFormat,computeUniformBufferFormats:{uniforms:this._uniformBufferFormat}})}findOptimalDispatchSize(e){let t=this.device.limits.maxComputeWorkgroupsPerDimension||65535;if(e<=t)return{x:e,y:1};let s=Math.floor(Math.sqrt(e)),r=Math.ceil(e/s);return{x:s,y:r}}resize(e,t){let s=this._countPassesNeeded(t),r=this.passes.length;if(s>r){this.destroyPasses(),this.createPassesRecursive(e,t);return}let i=t;for(let a=0;a<this.passes.length;a++){let o=Math.ceil(i/Sd),{x:n,y:c}=this.findOptimalDispatchSize(o);if(this.passes[a].count=i,this.passes[a].dispatchX=n,this.passes[a].dispatchY=c,i=o,o<=1)break}}destroyPasses(){for(let e of this.passes)e.scanCompute.destroy(),e.addBlockCompute?.destroy(),e.blockSumBuffer?.destroy();this.passes.length=0}_countPassesNeeded(e){let t=0,s=e;for(;s>0;){t++;let r=Math.ceil(s/Sd);if(r<=1)break;s=r}return t}dispatch(e){for(let t=0;t<this.passes.length;t++){let s=this.passes[t];s.scanCompute.setParameter("elementCount",s.count),s.scanCompute.setupDispatch(s.dispatchX,s.dispatchY,1),e.computeDispatch([s.scanCompute],"PrefixSumScan")}for(let t=this.passes.length-1;t>=0;t--){let s=this.passes[t];s.addBlockCompute&&(s.addBlockCompute.setParameter("elementCount",s.count),s.addBlockCompute.setupDispatch(s.dispatchX,s.dispatchY,1),e.computeDispatch([s.addBlockCompute],"PrefixSumAddBlock"))}}};var Qa=class{device;_indirect=!1;constructor(e,t=!1){this.device=e,this._indirect=t}_capacity=0;_allocatedElementCount=0;_elementCount=0;_numBits=0;_hasInitialValues=!1;_skipLastPassKeyWrite=!1;_destructiveKeys=!1;_keys0=null;_keys1=null;_values0=null;_values1=null;_indirectInfo=new Uint32Array(4);set capacity(e){this._capacity=e,e>this._allocatedElementCount&&this._destroyPingPongBuffers()}get capacity(){return this._capacity}get sortedIndices(){return this._values0?this._numBits/this.radixBits%2===1?this._values1:this._values0:null}get sortedKeys(){if(!this._keys0)return null;let e=this.radixBits;return this._numBits/e%2===0?this._keys1:this._keys0}get radixBits(){return 0}sort(e,t,s,r,i,a){return null}sortIndirect(e,t,s,r,i,a,o,n){return null}prepareIndirect(){return this._indirectInfo}_allocatePingPongElementBuffers(e){let t=e*4,s=12,r=this.device;this._keys0=new re(r,t,s),this._destructiveKeys||(this._keys1=new re(r,t,s)),this._values0=new re(r,t,s),this._values1=new re(r,t,s),this._allocatedElementCount=e}_destroyPingPongBuffers(){this._keys0?.destroy(),this._destructiveKeys||this._keys1?.destroy(),this._values0?.destroy(),this._values1?.destroy(),this._keys0=null,this._keys1=null,this._values0=null,this._values1=null,this._allocatedElementCount=0}destroy(){}};var aT=16,oT=16,nT=aT*oT,lT=8,cp=nT*lT,Td=4,iT=16,Ed=class extends Qa{_workgroupCount=0;_allocatedWorkgroupCount=0;_blockSums=null;_prefixSumKernel=null;_dispatchSize=new k(1,1);_histogramBindGroupFormat=null;_reorderBindGroupFormat=null;_uniformBufferFormat=null;_passes=[];constructor(e,t=!1){super(e,t);let s=this._indirectInfo;s[0]=1,s[1]=cp,this._uniformBufferFormat=new Te(e,[new I("workgroupCount",X),new I("elementCount",X)]);let r=[new V("input",B,!0),new V("block_sums",B,!1),new De("uniforms",B)],i=[new V("inputKeys",B,!0),new V("outputKeys",B,!1),new V("prefix_block_sum",B,!0),new V("inputValues",B,!0),new V("outputValues",B,!1),new De("uniforms",B)];t&&(r.push(new V("sortElementCount",B,!0)),i.push(new V("sortElementCount",B,!0))),this._histogramBindGroupFormat=new Ae(e,r),this._reorderBindGroupFormat=new Ae(e,i)}destroy(){this._destroyBuffers(),this._destroyPasses(),this._histogramBindGroupFormat?.destroy(),this._reorderBindGroupFormat?.destroy(),this._histogramBindGroupFormat=null,this._reorderBindGroupFormat=null,this._uniformBufferFormat=null,super.destroy()}_destroyPasses(){for(let e of this._passes)e.histogramCompute.destroy(),e.reorderCompute.destroy(),e.histogramCompute.shader?.destroy(),e.reorderCompute.shader?.destroy();this._passes.length=0,this._numBits=0}_destroyBuffers(){this._destroyPingPongBuffers(),this._blockSums?.destroy(),this._prefixSumKernel?.destroy(),this._blockSums=null,this._prefixSumKernel=null,this._workgroupCount=0,this._allocatedWorkgroupCount=0}get radixBits(){return Td}_createPasses(e,t,s){this._destroyPasses(),this._numBits=e,this._hasInitialValues=t,this._skipLastPassKeyWrite=s;let r=e/Td,i=this._indirect?"-Indirect":"";for(let a=0;a<r;a++){let o=a*Td,n=a===0&&!t,c=s&&a===r-1,h=this._createShader(`RadixSort4bit-Histogram${i}-${o}`,"",o,!1,!1,this._histogramBindGroupFormat),d=this._createShader(`RadixSort4bit-Reorder${i}-${o}`,"",o,n,c,this._reorderBindGroupFormat),f=new Ie(this.device,h,`RadixSort4bit-Histogram${i}-${o}`),u=new Ie(this.device,d,`RadixSort4bit-Reorder${i}-${o}`);this._passes.push({histogramCompute:f,reorderCompute:u})}}_allocateBuffers(e,t,s,r,i=!1){let a=Math.max(e,this.capacity),o=Math.ceil(a/cp),n=Math.max(1,Math.ceil(e/cp)),c=i||!this._keys0||a>this._allocatedElementCount||o<this._allocatedWorkgroupCount,h=t!==this._numBits||s!==this._hasInitialValues||r!==this._skipLastPassKeyWrite;if(c){this._destroyBuffers(),this._allocatedWorkgroupCount=o,this._capacity=a;let d=iT*o*4;this._allocatePingPongElementBuffers(a),this._blockSums=new re(this.device,d,12),this._prefixSumKernel=new Za(this.device)}this._workgroupCount=n,Ie.calcDispatchSize(n,this._dispatchSize,this.device.limits.maxComputeWorkgroupsPerDimension||65535),this._prefixSumKernel.resize(this._blockSums,iT*n),h&&this._createPasses(t,s,r)}_createShader(e,t,s,r,i,a){let o=new Map;return o.set("{WORKGROUP_SIZE_X}",aT),o.set("{WORKGROUP_SIZE_Y}",oT),o.set("{THREADS_PER_WORKGROUP}",nT),o.set("{ELEMENTS_PER_THREAD}",lT),o.set("{CURRENT_BIT}",s),o.set("{IS_FIRST_PASS}",r?1:0),o.set("{IS_LAST_PASS}",i?1:0),this._indirect&&o.set("USE_INDIRECT_SORT",""),new be(this.device,{name:e,shaderLanguage:q,cshader:t,cdefines:o,computeBindGroupFormat:a,computeUniformBufferFormats:{uniforms:this._uniformBufferFormat}})}sort(e,t,s=16,r,i=!1,a=!1){return this._execute(e,t,s,-1,null,r,i,a)}sortIndirect(e,t,s,r,i,a,o=!1,n=!1){return this._execute(e,t,s,r,i,a,o,n)}_execute(e,t,s,r,i,a,o=!1,n=!1){this._elementCount=t;let c=!!a,h=this._destructiveKeys;this._destructiveKeys=n,this._allocateBuffers(t,s,c,o,n!==h),n&&(this._keys1=e);let d=this.device,f=s/Td,u=this._indirect?"-Indirect":"",m=e,_=a??this._values0,p=this._keys0,g=this._values1;for(let T=0;T<f;T++){let{histogramCompute:S,reorderCompute:x}=this._passes[T],C=T===f-1;this._indirect&&this._blockSums.clear(),S.setParameter("input",m),S.setParameter("block_sums",this._blockSums),S.setParameter("workgroupCount",this._workgroupCount),S.setParameter("elementCount",t),this._indirect?(S.setParameter("sortElementCount",i),S.setupIndirectDispatch(r)):S.setupDispatch(this._dispatchSize.x,this._dispatchSize.y,1),d.computeDispatch([S],`RadixSort4bit-Histogram${u}`),this._prefixSumKernel.dispatch(d),x.setParameter("inputKeys",m),x.setParameter("outputKeys",p),x.setParameter("prefix_block_sum",this._blockSums),x.setParameter("inputValues",_),x.setParameter("outputValues",g),x.setParameter("workgroupCount",this._workgroupCount),x.setParameter("elementCount",t),this._indirect?(x.setParameter("sortElementCount",i),x.setupIndirectDispatch(r)):x.setupDispatch(this._dispatchSize.x,this._dispatchSize.y,1),d.computeDispatch([x],`RadixSort4bit-Reorder${u}`),C||(m=p,p=m===this._keys0?this._keys1:this._keys0,_=g,g=_===this._values0?this._values1:this._values0)}return this.sortedIndices}};var cT=256,hT=15,yd=cT*hT,aD=128,hp=32768,Cd=256,bn=4,vd=class extends Qa{_threadBlocks=0;_allocatedThreadBlocks=0;_globalHist=null;_passHist=null;_index=null;_binningDispatchSize=new k(1,1);_globalHistDispatchSize=new k(1,1);_globalHistBindGroupFormat=null;_scanBindGroupFormat=null;_binningBindGroupFormat=null;_globalHistUniformFormat=null;_scanUniformFormat=null;_binningUniformFormat=null;_globalHistShader=null;_scanShader=null;_binningShader=null;_globalHistCompute=null;_scanCompute=null;_binningComputes=[];constructor(e,t=!1){super(e,t);let s=this._indirectInfo;s[0]=2,s[1]=yd,s[2]=hp,this._globalHistUniformFormat=new Te(e,[new I("numKeys",X),new I("threadBlocks",X),new I("numPasses",X),new I("_pad",X)]),this._scanUniformFormat=new Te(e,[new I("threadBlocks",X),new I("_pad0",X),new I("_pad1",X),new I("_pad2",X)]),this._binningUniformFormat=new Te(e,[new I("numKeys",X),new I("threadBlocks",X),new I("pass_",X),new I("flags",X)]);let r=e.minSubgroupSize||e.maxSubgroupSize||32,i=Math.max(1,Math.ceil(256/r)),a=t?"Indirect":"",o=[new V("b_sort",B,!0),new V("b_globalHist",B,!1),new De("uniforms",B)],n=[new V("b_globalHist",B,!0),new V("b_passHist",B,!1),new De("uniforms",B)],c=[new V("inputKeys",B,!0),new V("outputKeys",B,!1),new V("inputValues",B,!0),new V("outputValues",B,!1),new V("b_passHist",B,!1),new V("b_index",B,!1),new De("uniforms",B)];t&&(o.push(new V("b_sortElementCount",B,!0)),n.push(new V("b_sortElementCount",B,!0)),c.push(new V("b_sortElementCount",B,!0))),this._globalHistBindGroupFormat=new Ae(e,o),this._scanBindGroupFormat=new Ae(e,n),this._binningBindGroupFormat=new Ae(e,c);let h=new Map;h.set("{G_HIST_DIM}",aD),h.set("{G_HIST_PART_SIZE}",hp),t&&h.set("USE_INDIRECT_SORT",""),this._globalHistShader=new be(e,{name:`OneSweepGlobalHist${a}`,shaderLanguage:q,cshader:"",cdefines:h,computeBindGroupFormat:this._globalHistBindGroupFormat,computeUniformBufferFormats:{uniforms:this._globalHistUniformFormat}});let d=new Map;d.set("{MAX_SUBGROUPS}",i),d.set("{PART_SIZE}",yd),t&&d.set("USE_INDIRECT_SORT",""),this._scanShader=new be(e,{name:`OneSweepScan${a}`,shaderLanguage:q,cshader:"",cdefines:d,computeBindGroupFormat:this._scanBindGroupFormat,computeUniformBufferFormats:{uniforms:this._scanUniformFormat}});let f=new Map;f.set("{D_DIM}",cT),f.set("{KEYS_PER_THREAD}",hT),f.set("{MAX_SUBGROUPS}",i),t&&f.set("USE_INDIRECT_SORT",""),this._binningShader=new be(e,{name:`OneSweepBinning${a}`,shaderLanguage:q,cshader:"",cdefines:f,computeBindGroupFormat:this._binningBindGroupFormat,computeUniformBufferFormats:{uniforms:this._binningUniformFormat}}),this._globalHistCompute=new Ie(e,this._globalHistShader,this._globalHistShader.name),this._scanCompute=new Ie(e,this._scanShader,this._scanShader.name)}destroy(){this._destroyBuffers(),this._globalHistCompute?.destroy(),this._scanCompute?.destroy();for(let e of this._binningComputes)e.destroy();this._globalHistShader?.destroy(),this._scanShader?.destroy(),this._binningShader?.destroy(),this._globalHistBindGroupFormat?.destroy(),this._scanBindGroupFormat?.destroy(),this._binningBindGroupFormat?.destroy(),this._globalHistShader=null,this._scanShader=null,this._binningShader=null,this._globalHistCompute=null,this._scanCompute=null,this._binningComputes.length=0,this._globalHistBindGroupFormat=null,this._scanBindGroupFormat=null,this._binningBindGroupFormat=null,this._globalHistUniformFormat=null,this._scanUniformFormat=null,this._binningUniformFormat=null,super.destroy()}_destroyBuffers(){this._destroyPingPongBuffers(),this._globalHist?.destroy(),this._passHist?.destroy(),this._index?.destroy(),this._globalHist=null,this._passHist=null,this._index=null,this._allocatedThreadBlocks=0,this._threadBlocks=0}get radixBits(){return 8}_ensureBinningComputes(e){for(;this._binningComputes.length<e;)this._binningComputes.push(new Ie(this.device,this._binningShader,`OneSweepBinning-${this._binningComputes.length}`))}_allocateBuffers(e,t=!1){let s=Math.max(e,this.capacity),r=Math.max(1,Math.ceil(s/yd)),i=Math.max(1,Math.ceil(e/yd));if(t||!this._keys0||s>this._allocatedElementCount||r<this._allocatedThreadBlocks){this._destroyBuffers(),this._allocatedThreadBlocks=r,this._capacity=s;let c=this.device;this._allocatePingPongElementBuffers(s),this._globalHist=new re(c,bn*Cd*4,8),this._passHist=new re(c,bn*r*Cd*4,8),this._index=new re(c,bn*4,8)}this._threadBlocks=i;let o=this.device.limits.maxComputeWorkgroupsPerDimension||65535;Ie.calcDispatchSize(i,this._binningDispatchSize,o);let n=Math.max(1,Math.ceil(e/hp));Ie.calcDispatchSize(n,this._globalHistDispatchSize,o)}sort(e,t,s=16,r,i=!1,a=!1){let o=s/8,n=!!r;this._elementCount=t,this._numBits=s,this._hasInitialValues=n,this._skipLastPassKeyWrite=i;let c=this._destructiveKeys;this._destructiveKeys=a,this._allocateBuffers(t,a!==c),this._ensureBinningComputes(o),a&&(this._keys1=e);let h=this.device;this._globalHist.clear(),this._passHist.clear(0,bn*this._threadBlocks*Cd*4),this._index.clear();let d=this._globalHistCompute;d.setParameter("b_sort",e),d.setParameter("b_globalHist",this._globalHist),d.setParameter("numKeys",t),d.setParameter("threadBlocks",this._threadBlocks),d.setParameter("numPasses",o),d.setParameter("_pad",0),d.setupDispatch(this._globalHistDispatchSize.x,this._globalHistDispatchSize.y,1),h.computeDispatch([d],"OneSweep-GlobalHist");let f=this._scanCompute;f.setParameter("b_globalHist",this._globalHist),f.setParameter("b_passHist",this._passHist),f.setParameter("threadBlocks",this._threadBlocks),f.setParameter("_pad0",0),f.setParameter("_pad1",0),f.setParameter("_pad2",0),f.setupDispatch(o,1,1),h.computeDispatch([f],"OneSweep-Scan");let u=e,m=r??this._values0,_=this._keys0,p=this._values1;for(let g=0;g<o;g++){let T=g===0&&!n,S=g===o-1,x=(T?1:0)|(S&&i?2:0),C=this._binningComputes[g];C.setParameter("inputKeys",u),C.setParameter("outputKeys",_),C.setParameter("inputValues",m),C.setParameter("outputValues",p),C.setParameter("b_passHist",this._passHist),C.setParameter("b_index",this._index),C.setParameter("numKeys",t),C.setParameter("threadBlocks",this._threadBlocks),C.setParameter("pass_",g),C.setParameter("flags",x),C.setupDispatch(this._binningDispatchSize.x,this._binningDispatchSize.y,1),h.computeDispatch([C],`OneSweep-Binning-${g}`),S||(u=_,_=u===this._keys0?this._keys1:this._keys0,m=p,p=m===this._values0?this._values1:this._values0)}return this.sortedIndices}sortIndirect(e,t,s,r,i,a,o=!1,n=!1){let c=s/8,h=!!a;this._elementCount=t,this._numBits=s,this._hasInitialValues=h,this._skipLastPassKeyWrite=o;let d=this._destructiveKeys;this._destructiveKeys=n,this._allocateBuffers(t,n!==d),this._ensureBinningComputes(c),n&&(this._keys1=e);let f=this.device;this._globalHist.clear(),this._passHist.clear(0,bn*this._allocatedThreadBlocks*Cd*4),this._index.clear();let u=this._globalHistCompute;u.setParameter("b_sort",e),u.setParameter("b_globalHist",this._globalHist),u.setParameter("b_sortElementCount",i),u.setParameter("numKeys",0),u.setParameter("threadBlocks",0),u.setParameter("numPasses",c),u.setParameter("_pad",0),u.setupIndirectDispatch(r+1),f.computeDispatch([u],"OneSweep-GlobalHistIndirect");let m=this._scanCompute;m.setParameter("b_globalHist",this._globalHist),m.setParameter("b_passHist",this._passHist),m.setParameter("b_sortElementCount",i),m.setParameter("threadBlocks",0),m.setParameter("_pad0",0),m.setParameter("_pad1",0),m.setParameter("_pad2",0),m.setupDispatch(c,1,1),f.computeDispatch([m],"OneSweep-ScanIndirect");let _=e,p=a??this._values0,g=this._keys0,T=this._values1;for(let S=0;S<c;S++){let x=S===0&&!h,C=S===c-1,E=(x?1:0)|(C&&o?2:0),v=this._binningComputes[S];v.setParameter("inputKeys",_),v.setParameter("outputKeys",g),v.setParameter("inputValues",p),v.setParameter("outputValues",T),v.setParameter("b_passHist",this._passHist),v.setParameter("b_index",this._index),v.setParameter("b_sortElementCount",i),v.setParameter("numKeys",0),v.setParameter("threadBlocks",0),v.setParameter("pass_",S),v.setParameter("flags",E),v.setupIndirectDispatch(r),f.computeDispatch([v],`OneSweep-BinningIndirect-${S}`),C||(_=g,g=_===this._keys0?this._keys1:this._keys0,p=T,T=p===this._values0?this._values1:this._values0)}return this.sortedIndices}};var xd=class{_impl;constructor(e,t={}){let s=t.kind??fm,r=t.indirect??!1,i=s;s===fm&&(i=this._canUseOneSweep(e)?um:jg),i===um?(this._canUseOneSweep(e),this._impl=new vd(e,r)):this._impl=new Ed(e,r)}_canUseOneSweep(e){return!(!e.supportsCompute||!e.supportsSubgroups||e.gpuAdapter?.info?.vendor?.toLowerCase?.()!=="nvidia"||e.minSubgroupSize>32)}get sortedIndices(){return this._impl.sortedIndices}get sortedKeys(){return this._impl.sortedKeys}get radixBits(){return this._impl.radixBits}set capacity(e){this._impl.capacity=e}get capacity(){return this._impl.capacity}sort(e,t,s=16,r,i,a=!1){return this._impl.sort(e,t,s,r,i,a)}sortIndirect(e,t,s,r,i,a,o,n=!1){return this._impl.sortIndirect(e,t,s,r,i,a,o,n)}prepareIndirect(){return this._impl.prepareIndirect()}destroy(){this._impl.destroy()}};var Ad=class{processedCache=new Map;definitionsCache=new Map;_generators=new Map;constructor(e){this._device=e,this._isClearingCache=!1,e.on("destroy:shader",t=>{this.removeFromCache(t)})}destroy(){this.clearCache()}register(e,t){this._generators.has(e)||this._generators.set(e,t)}unregister(e){this._generators.has(e)&&this._generators.delete(e)}isRegistered(e){return this._generators.has(e)}generateShaderDefinition(e,t,s,r){let i=this.definitionsCache.get(s);if(!i){let a=this._device;i=e.createShaderDefinition(a,r),i.name=i.name??(r.pass?`${t}-pass:${r.pass}`:t),this.definitionsCache.set(s,i)}return i}getCachedShader(e){return this.processedCache.get(e)}setCachedShader(e,t){this.processedCache.set(e,t)}getProgram(e,t,s,r){let i=this._generators.get(e);if(!i)return null;let a=i.generateKey(t),o=$e(a),n=s.generateKey(this._device),c=$e(n),h=`${o}#${c}`,d=this.getCachedShader(h);if(!d){let f=this.generateShaderDefinition(i,e,o,t),u="",m;t.pass!==void 0&&(m=at.get(this._device).getByIndex(t.pass),u=`-${m.name}`),this._device.fire("shader:generate",{userMaterialId:r,shaderPassInfo:m,definition:f});let _={name:`${f.name}${u}-proc`,attributes:f.attributes,vshader:f.vshader,vincludes:f.vincludes,fincludes:f.fincludes,fshader:f.fshader,processingOptions:s,shaderLanguage:f.shaderLanguage,useDualSourceBlending:f.useDualSourceBlending,meshUniformBufferFormat:f.meshUniformBufferFormat,meshBindGroupFormat:f.meshBindGroupFormat};d=new be(this._device,_),this.setCachedShader(h,d)}return d}clearCache(){this._isClearingCache=!0,this.processedCache.forEach(e=>{e.destroy()}),this.processedCache.clear(),this._isClearingCache=!1}removeFromCache(e){this._isClearingCache||this.processedCache.forEach((t,s)=>{e===t&&this.processedCache.delete(s)})}};var Sr=class{device;format=null;textures=new Map;_textureDimensions=new k;_isInstance=!1;_formatVersion=-1;get textureDimensions(){return this._textureDimensions}constructor(e,t=!1){this.device=e,this._isInstance=t}destroy(){for(let e of this.textures.values())e.destroy();this.textures.clear()}init(e,t){this.format=e,this._textureDimensions=et.calcTextureSize(t,new k);let s=this._isInstance?e.instanceStreams:e.resourceStreams;for(let r of s){let i=this.createTexture(r.name,r.format,this._textureDimensions);this.textures.set(r.name,i)}this._formatVersion=e.extraStreamsVersion}getTexture(e){return this.syncWithFormat(this.format),this.textures.get(e)}getTexturesInOrder(){let e=[];if(this.format){let t=this._isInstance?this.format.instanceStreams:this.format.resourceStreams;for(let s of t){let r=this.textures.get(s.name);r&&e.push(r)}}return e}syncWithFormat(e){if(e){if(this.format===e&&this._formatVersion===e.extraStreamsVersion)return;this.format=e;let t=this._isInstance?e.instanceStreams:e.resourceStreams;for(let s of t)if(!this.textures.has(s.name)){let r=this.createTexture(s.name,s.format,this._textureDimensions);this.textures.set(s.name,r)}this._formatVersion=e.extraStreamsVersion}}resize(e,t){this._textureDimensions.set(e,t);for(let s of this.textures.values())s.resize(e,t)}createTexture(e,t,s,r){return se.createDataTexture2D(this.device,e,s.x,s.y,t,r?[r]:void 0)}};var Ja=class l{static _cache=new Se;_pendingDestroy=new Set;static queueDestroy(e,t){this._cache.get(e,()=>new l)._pendingDestroy.add(t)}static process(e){let t=this._cache.get(e,()=>new l)._pendingDestroy;for(let s of t)s.refCount===0&&(s._actualDestroy(),t.delete(s))}destroy(){this._pendingDestroy.clear()}};var oD=0,Ce=class l{device;gsplatData;set centers(e){this._centers=e}get centers(){return this._centers}get hasCenters(){return this._centers!=null}_centers=null;centersVersion=0;aabb;mesh=null;id=oD++;workBufferRenderInfos=new Map;_format=null;streams;parameters=new Map;_refCount=0;_meshRefCount=0;constructor(e,t,s={}){this.device=e,this.gsplatData=t,this.streams=new Sr(e),s.prepareCenters!==!1?this._centers=t.getCenters():this._centers=null,this.aabb=new J,t.calcAabb(this.aabb)}destroy(){if(this.refCount>0){Ja.queueDestroy(this.device,this);return}this._actualDestroy()}_actualDestroy(){this.streams.destroy(),this.mesh?.destroy(),this.workBufferRenderInfos.forEach(e=>e.destroy()),this.workBufferRenderInfos.clear()}incRefCount(){this._refCount++}decRefCount(){this._refCount--}get refCount(){return this._refCount}ensureMesh(){this.mesh||(this.mesh=l.createMesh(this.device),this.mesh.aabb.copy(this.aabb)),this._meshRefCount++}releaseMesh(){this._meshRefCount--,this._meshRefCount<1&&(this.mesh=null)}get supportsWorkBufferGeometry(){return!1}static createMesh(e){let t=l.instanceSize,s=new Float32Array(12*t),r=new Uint32Array(6*t);for(let a=0;a<t;++a){s.set([-1,-1,a,1,-1,a,1,1,a,-1,1,a],a*12);let o=a*4;r.set([0+o,1+o,2+o,0+o,2+o,3+o],a*6)}let i=new ts(e);return i.setPositions(s,3),i.setIndices(r),i.update(),i}static get instanceSize(){return 128}get numSplats(){return this.gsplatData.numSplats}get format(){return this._format}getTexture(e){return this.streams.getTexture(e)??null}get textureDimensions(){return this.streams.textureDimensions}configureMaterial(e,t,s){this.configureMaterialDefines(e.defines),this.streams.syncWithFormat(this.format);let r=this.device.isWebGPU?e.shaderChunks.wgsl:e.shaderChunks.glsl;r.set("gsplatDeclarationsVS",s),r.set("gsplatReadVS",this.format.getReadCode()),t?.code&&r.set("gsplatModifyVS",t.code);for(let[i,a]of this.streams.textures)e.setParameter(i,a);for(let[i,a]of this.parameters)e.setParameter(i,a);this.textureDimensions.x>0&&e.setParameter("splatTextureSize",this.textureDimensions.x)}configureMaterialDefines(e){}instantiate(){}};var Fn=class extends Ce{_maxSplats=0;_numSplats=0;constructor(e,t,s){let r=new J,i={numSplats:t,getCenters:()=>null,calcAabb:a=>a.copy(r)};super(e,i,{prepareCenters:!1}),this._format=s,this._maxSplats=t,this._numSplats=t,this.streams.init(this._format,t)}set centers(e){this._centers=e}get centers(){return this._centers===null&&(this._centers=new Float32Array(this._maxSplats*3),this.centersVersion++),this._centers}get maxSplats(){return this._maxSplats}get numSplats(){return this._numSplats}update(e=this._numSplats,t=!0){this._numSplats=O.clamp(e,0,this._maxSplats),t&&this.centersVersion++}configureMaterialDefines(e){e.set("SH_BANDS","0")}configureMaterial(e,t=null,s){super.configureMaterial(e,t,s);let r=this.device.isWebGPU?e.shaderChunks.wgsl:e.shaderChunks.glsl;r.set("gsplatContainerDeclarationsVS",this.format.getInputDeclarations()),r.set("gsplatDeclarationsVS",'#include "gsplatContainerDeclVS"'),r.set("gsplatReadVS",this.format.getReadCode())}};var eo=new N,dT=new fe,dp=new J,fT=new J,nD=new z(1,1,0,.4),fp=.28209479177387814,up=class{constructor(e,t,s,r,i){let a=e.activated,o=e.getProp("x"),n=e.getProp("y"),c=e.getProp("z"),h=e.getProp("rot_1"),d=e.getProp("rot_2"),f=e.getProp("rot_3"),u=e.getProp("rot_0"),m=e.getProp("scale_0"),_=e.getProp("scale_1"),p=e.getProp("scale_2"),g=e.getProp("f_dc_0"),T=e.getProp("f_dc_1"),S=e.getProp("f_dc_2"),x=e.getProp("opacity"),C=E=>{if(E>0)return 1/(1+Math.exp(-E));let v=Math.exp(E);return v/(1+v)};this.read=E=>{t&&(t.x=o[E],t.y=n[E],t.z=c[E]),s&&s.set(h[E],d[E],f[E],u[E]),r&&(a?r.set(m[E],_[E],p[E]):r.set(Math.exp(m[E]),Math.exp(_[E]),Math.exp(p[E]))),i&&i.set(.5+g[E]*fp,.5+T[E]*fp,.5+S[E]*fp,a?x[E]:C(x[E]))}}},uT=(l,e,t)=>{dT.set(t.x,t.y,t.z,t.w).normalize(),l.setTRS(e,dT,y.ONE)},Rd=class l{elements;numSplats;comments;activated=!1;constructor(e,t=[]){this.elements=e,this.numSplats=this.getElement("vertex").count,this.comments=t}static calcSplatAabb(e,t,s,r){uT(eo,t,s),dp.center.set(0,0,0),dp.halfExtents.set(r.x*2,r.y*2,r.z*2),e.setFromTransformedAabb(dp,eo)}getProp(e,t="vertex"){return this.getElement(t)?.properties.find(s=>s.name===e)?.storage}getElement(e){return this.elements.find(t=>t.name===e)}addProp(e,t){this.getElement("vertex").properties.push({type:"float",name:e,storage:t,byteSize:4})}createIter(e,t,s,r){return new up(this,e,t,s,r)}calcAabb(e,t){let s,r,i,a,o,n,c=!0,h=this.getProp("x"),d=this.getProp("y"),f=this.getProp("z"),u=this.getProp("scale_0"),m=this.getProp("scale_1"),_=this.getProp("scale_2");for(let p=0;p<this.numSplats;++p){if(t&&!t(p))continue;let g=h[p],T=d[p],S=f[p],x=Math.max(u[p],m[p],_[p]);if(!isFinite(g)||!isFinite(T)||!isFinite(S)||!isFinite(x))continue;let C=2*(this.activated?x:Math.exp(x));c?(c=!1,s=g-C,r=T-C,i=S-C,a=g+C,o=T+C,n=S+C):(s=Math.min(s,g-C),r=Math.min(r,T-C),i=Math.min(i,S-C),a=Math.max(a,g+C),o=Math.max(o,T+C),n=Math.max(n,S+C))}return c||(e.center.set((s+a)*.5,(r+o)*.5,(i+n)*.5),e.halfExtents.set((a-s)*.5,(o-r)*.5,(n-i)*.5)),!c}calcAabbExact(e,t){let s=new y,r=new fe,i=new y,a=this.createIter(s,r,i),o=!0;for(let n=0;n<this.numSplats;++n)t&&!t(n)||(a.read(n),o?(o=!1,l.calcSplatAabb(e,s,r,i)):(l.calcSplatAabb(fT,s,r,i),e.add(fT)));return!o}getCenters(){let e=this.getProp("x"),t=this.getProp("y"),s=this.getProp("z"),r=new Float32Array(this.numSplats*3);for(let i=0;i<this.numSplats;++i)r[i*3+0]=e[i],r[i*3+1]=t[i],r[i*3+2]=s[i];return r}calcFocalPoint(e,t){let s=this.getProp("x"),r=this.getProp("y"),i=this.getProp("z"),a=this.getProp("scale_0"),o=this.getProp("scale_1"),n=this.getProp("scale_2");e.x=0,e.y=0,e.z=0;let c=0;for(let h=0;h<this.numSplats;++h){if(t&&!t(h))continue;let d=s[h],f=r[h],u=i[h];if(!isFinite(d)||!isFinite(f)||!isFinite(u))continue;let m=Math.max(a[h],o[h],n[h]),_=1/(1+(this.activated?m:Math.exp(m)));e.x+=d*_,e.y+=f*_,e.z+=u*_,c+=_}e.mulScalar(1/c)}renderWireframeBounds(e,t){let s=new y,r=new fe,i=new y,a=new y,o=new y,n=this.createIter(s,r,i);for(let c=0;c<this.numSplats;++c)n.read(c),uT(eo,s,r),eo.mul2(t,eo),a.set(i.x*-2,i.y*-2,i.z*-2),o.set(i.x*2,i.y*2,i.z*2),e.immediate.drawWireAlignedBox(a,o,nD,!0,e.defaultDrawLayer,eo)}get isCompressed(){return!1}get shBands(){return{9:1,24:2,45:3}[(()=>{for(let s=0;s<45;++s)if(!this.getProp(`f_rest_${s}`))return s;return 45})()]??0}calcMortonOrder(){let e=S=>{let x=S[0],C=S[0];for(let E=1;E<S.length;E++)S[E]<x&&(x=S[E]),S[E]>C&&(C=S[E]);return{min:x,max:C}},t=(S,x,C)=>{let E=v=>(v&=1023,v=(v^v<<16)&4278190335,v=(v^v<<8)&50393103,v=(v^v<<4)&51130563,v=(v^v<<2)&153391689,v);return(E(C)<<2)+(E(x)<<1)+E(S)},s=this.getProp("x"),r=this.getProp("y"),i=this.getProp("z"),{min:a,max:o}=e(s),{min:n,max:c}=e(r),{min:h,max:d}=e(i),f=a===o?0:1024/(o-a),u=n===c?0:1024/(c-n),m=h===d?0:1024/(d-h),_=new Map;for(let S=0;S<this.numSplats;S++){let x=Math.min(1023,Math.floor((s[S]-a)*f)),C=Math.min(1023,Math.floor((r[S]-n)*u)),E=Math.min(1023,Math.floor((i[S]-h)*m)),v=t(x,C,E),A=_.get(v);A?A.push(S):_.set(v,[S])}let p=Array.from(_.keys()).sort((S,x)=>S-x),g=new Uint32Array(this.numSplats),T=0;for(let S=0;S<p.length;++S){let x=_.get(p[S]);for(let C=0;C<x.length;++C)g[T++]=x[C]}return g}reorder(e){let t=new Map,s=a=>{if(t.has(a)){let o=t.get(a);return t.delete(a),o}return new ArrayBuffer(a)},r=a=>{t.set(a.byteLength,a)},i=a=>{let o=new a.constructor(s(a.byteLength));for(let n=0;n<e.length;n++)o[n]=a[e[n]];return r(a.buffer),o};this.elements.forEach(a=>{a.properties.forEach(o=>{o.storage&&(o.storage=i(o.storage))})})}reorderData(){this.reorder(this.calcMortonOrder())}};var mT=`
uniform highp {sampler} {name};
{returnType} load{funcName}() { return texelFetch({name}, splat.uv, 0); }
{returnType} load{funcName}WithIndex(uint index) { return texelFetch({name}, ivec2(index % splatTextureSize, index / splatTextureSize), 0); }
`;var mp=`
void write{funcName}({returnType} value) {
#if {defineGuard}
	pcFragColor{index} = value;
#endif
}
`;var Pd=`
vec3 getCenter() { return loadDataCenter().xyz; }
vec4 getColor() { return loadDataColor(); }
vec3 getScale() { return loadDataScale().xyz; }
vec4 getRotation() { return loadDataRotation(); }
`;var pT=`
	vec3 getCenter() { return loadDataCenter().xyz; }
	vec4 getColor() { return loadDataColor(); }
	vec3 getScale() { return vec3(loadDataCenter().w); }
	vec4 getRotation() { return vec4(0.0, 0.0, 0.0, 1.0); }
`;var _T=l=>l.map(e=>`${e.name}:${e.format}:${e.storage}`).join(","),pp=0,gT=/\{name\}/g,hD=/\{sampler\}/g,ST=/\{textureType\}/g,Dd=/\{returnType\}/g,Id=/\{funcName\}/g,dD=/\{binding\}/g,fD=/\{index\}/g,uD=/\{colorSlot\}/g,TT=/\{defineGuard\}/g,Gs=class l{_device;streams;_read;allowStreamRemoval=!1;dataFormat=null;_extraStreams=[];_streamNames=new Set;_extraStreamsVersion=++pp;_hash;_resourceStreams=null;_instanceStreams=null;constructor(e,t,s){this._device=e,this.streams=[...t],this._streamNames=new Set(this.streams.map(i=>i.name));let r=e.isWebGPU;this._read=r?s.readWGSL:s.readGLSL}get hash(){if(this._hash===void 0){let e=_T(this.streams),t=_T(this._extraStreams);this._hash=$e(e+t+this._read)}return this._hash}get extraStreamsVersion(){return this._extraStreamsVersion}get extraStreams(){return this._extraStreams}get resourceStreams(){return this._resourceStreams===null&&(this._resourceStreams=[...this.streams.filter(e=>e.storage!==Jc),...this._extraStreams.filter(e=>e.storage!==Jc)]),this._resourceStreams}get instanceStreams(){return this._instanceStreams===null&&(this._instanceStreams=this._extraStreams.filter(e=>e.storage===Jc)),this._instanceStreams}addExtraStreams(e){if(!e||e.length===0)return;let t=!1;for(let s of e)this._streamNames.has(s.name)||(this._extraStreams.push({name:s.name,format:s.format,storage:s.storage??zg}),this._streamNames.add(s.name),t=!0);t&&(this._extraStreamsVersion=++pp,this._invalidateCaches())}removeExtraStreams(e){if(!this.allowStreamRemoval)return;let t=!1;for(let s of e){let r=this._extraStreams.findIndex(i=>i.name===s);r!==-1&&(this._extraStreams.splice(r,1),this._streamNames.delete(s),t=!0)}t&&(this._extraStreamsVersion=++pp,this._invalidateCaches())}getInputDeclarations(e){let t=this._device.isWebGPU,s=t?"":mT,r=t?Io:ji,i=[],a=[...this.streams,...this._extraStreams];e&&(a=a.filter(o=>e.includes(o.name)));for(let o of a){let n=r(o.format),c=o.name.charAt(0).toUpperCase()+o.name.slice(1),h=n.textureType??"";t&&o.format===We&&(h="texture_2d<uff>");let d=s.replace(gT,o.name).replace(hD,n.sampler??"").replace(ST,h).replace(Dd,n.returnType).replace(Id,c);i.push(d)}return i.join(`
`)}getReadCode(){return this._read}getComputeInputDeclarations(e,t){let s=[],r=[...this.streams,...this._extraStreams];t&&(r=r.filter(i=>t.includes(i.name)));for(let i=0;i<r.length;i++){let a=r[i],o=Io(a.format),n=a.name.charAt(0).toUpperCase()+a.name.slice(1),c=o.textureType??"";a.format===We&&(c="texture_2d<uff>");let h="".replace(dD,String(e+i)).replace(gT,a.name).replace(ST,c).replace(Dd,o.returnType).replace(Id,n);s.push(h)}return s.join(`
`)}getComputeBindFormats(e){let t=[...this.streams,...this._extraStreams];return e&&(t=t.filter(s=>e.includes(s.name))),t.map(s=>{let r=rt.get(s.format),i=ni;return r?.isUint?i=Bo:r?.isInt&&(i=No),new Ds(s.name,B,void 0,i,!1)})}setWriteCode(e,t){this._write=this._device.isWebGPU?t:e}getWriteCode(){return this._write}getOutputDeclarations(e){let t=this._device.isWebGPU,s=[],r=t?"":mp,i=t?Io:ji;for(let a=0;a<e.length;a++){let o=e[a],n=i(o.format),c=o.name.charAt(0).toUpperCase()+o.name.slice(1),h=a===0?"color":`color${a}`,d=r.replace(Id,c).replace(Dd,n.returnType).replace(fD,String(a)).replace(uD,h).replace(TT,"1");s.push(d)}return s.join(`
`)}getOutputStubs(e){let t=this._device.isWebGPU,s=[],r=t?"":mp,i=t?Io:ji;for(let a of e){let o=i(a.format),n=a.name.charAt(0).toUpperCase()+a.name.slice(1),c=r.replace(Id,n).replace(Dd,o.returnType).replace(TT,"0");s.push(c)}return s.join(`
`)}getStream(e){let t=this.streams.find(s=>s.name===e);return t||(t=this._extraStreams.find(s=>s.name===e)),t}_invalidateCaches(){this._hash=void 0,this._resourceStreams=null,this._instanceStreams=null}static createDefaultFormat(e){return new l(e,[{name:"dataColor",format:ge},{name:"dataCenter",format:We},{name:"dataScale",format:ge},{name:"dataRotation",format:ge}],{readGLSL:Pd,readWGSL:""})}static createSimpleFormat(e){return new l(e,[{name:"dataCenter",format:We},{name:"dataColor",format:ge}],{readGLSL:pT,readWGSL:""})}};var to=class{_deviceLostEvent=null;constructor(e,t=!1){this.device=e,this.useSingleBuffer=t,this.impl=e.createUploadStreamImpl(this),this._deviceLostEvent=this.device.on("devicelost",this._onDeviceLost,this)}destroy(){this._deviceLostEvent?.off(),this._deviceLostEvent=null,this.impl?.destroy(),this.impl=null}upload(e,t,s=0,r=e.length){this.impl?.upload(e,t,s,r)}_onDeviceLost(){this.impl?._onDeviceLost?.()}};function ET(l){let e,t,s,r,i,a,o=!1,n={x:0,y:0,z:0},c={x:0,y:0,z:0},h={x:0,y:0,z:0},d={x:0,y:0,z:0},f,u,m=32,_=new Array(m).fill(0),p=new Array(m).fill(0),g=new Array(m).fill(0),T=(x,C,E)=>{for(;x<=C;){let v=C+x>>1,A=E(v);if(A>0)x=v+1;else if(A<0)C=v-1;else return v}return~x},S=()=>{if(!e||!t||t.length===0||!i||!a)return;let x=performance.now(),C=i.x,E=i.y,v=i.z,A=a.x,D=a.y,R=a.z,w=.001;if(!o&&Math.abs(C-n.x)<w&&Math.abs(E-n.y)<w&&Math.abs(v-n.z)<w&&Math.abs(A-c.x)<w&&Math.abs(D-c.y)<w&&Math.abs(R-c.z)<w)return;o=!1,n.x=C,n.y=E,n.z=v,c.x=A,c.y=D,c.z=R;let M,P;for(let H=0;H<8;++H){let ee=H&1?h.x:d.x,Ze=H&2?h.y:d.y,he=H&4?h.z:d.z,j=ee*A+Ze*D+he*R;H===0?M=P=j:(M=Math.min(M,j),P=Math.max(P,j))}let L=t.length/3,U=2**Math.max(10,Math.min(20,Math.round(Math.log2(L/4))))+1;f?.length!==L&&(f=new Uint32Array(L)),!u||u.length!==U?u=new Uint32Array(U):u.fill(0);let F=P-M;if(F<1e-6)for(let H=0;H<L;++H)f[H]=0,u[0]++;else{let H=s.length/4;_.fill(0);for(let j=0;j<H;++j){let He=s[j*4+0],ut=s[j*4+1],Ct=s[j*4+2],Ht=s[j*4+3],vt=He*A+ut*D+Ct*R-M,ii=Math.max(0,Math.floor((vt-Ht)*m/F)),Ni=Math.min(m,Math.ceil((vt+Ht)*m/F));for(let Ws=ii;Ws<Ni;++Ws)_[Ws]++}let ee=_.reduce((j,He)=>j+He,0);for(let j=0;j<m;++j)g[j]=_[j]/ee*U>>>0;for(let j=0;j<m;++j)p[j]=j===0?0:p[j-1]+g[j-1];let Ze=F/m,he=0;for(let j=0;j<L;++j){let He=t[he++],ut=t[he++],Ct=t[he++],Ht=(He*A+ut*D+Ct*R-M)/Ze,vt=Ht>>>0,ii=p[vt]+g[vt]*(Ht-vt)>>>0;f[j]=ii,u[ii]++}}for(let H=1;H<U;H++)u[H]+=u[H-1];for(let H=0;H<L;H++){let ee=f[H],Ze=--u[ee];e[Ze]=H}let Y=C*A+E*D+v*R,K=H=>{let ee=e[H]*3;return t[ee++]*A+t[ee++]*D+t[ee]*R-Y},W=()=>{let H=T(0,L-1,ee=>-K(ee));return Math.min(L,Math.abs(H))},ae=K(L-1)>=0?W():L;if(r)for(let H=0;H<L;++H)e[H]=r[e[H]];l.postMessage({order:e.buffer,count:ae,sortTime:performance.now()-x},[e.buffer]),e=null};l.addEventListener("message",x=>{let C=x.data??x;if(C.order&&(e=new Uint32Array(C.order)),C.centers)if(t=new Float32Array(C.centers),o=!0,C.chunks){let E=new Float32Array(C.chunks);s=new Float32Array(C.chunks,0,E.length*4/6),h.x=E[0],h.y=E[1],h.z=E[2],d.x=E[3],d.y=E[4],d.z=E[5];for(let v=0;v<E.length/6;++v){let A=E[v*6+0],D=E[v*6+1],R=E[v*6+2],w=E[v*6+3],M=E[v*6+4],P=E[v*6+5];s[v*4+0]=(A+w)*.5,s[v*4+1]=(D+M)*.5,s[v*4+2]=(R+P)*.5,s[v*4+3]=Math.sqrt((w-A)**2+(M-D)**2+(P-R)**2)*.5,A<h.x&&(h.x=A),D<h.y&&(h.y=D),R<h.z&&(h.z=R),w>d.x&&(d.x=w),M>d.y&&(d.y=M),P>d.z&&(d.z=P)}}else{let E=t.length/3,v=Math.ceil(E/256);s=new Float32Array(v*4),h.x=h.y=h.z=1/0,d.x=d.y=d.z=-1/0;let A,D,R,w,M,P;for(let L=0;L<v;++L){A=D=R=1/0,w=M=P=-1/0;let G=L*256,U=Math.min(E,(L+1)*256);for(let F=G;F<U;++F){let Y=t[F*3+0],K=t[F*3+1],W=t[F*3+2],ae=Number.isFinite(Y),H=Number.isFinite(K),ee=Number.isFinite(W);ae||(t[F*3+0]=0),H||(t[F*3+1]=0),ee||(t[F*3+2]=0),!(!ae||!H||!ee)&&(Y<A?A=Y:Y>w&&(w=Y),K<D?D=K:K>M&&(M=K),W<R?R=W:W>P&&(P=W),Y<h.x?h.x=Y:Y>d.x&&(d.x=Y),K<h.y?h.y=K:K>d.y&&(d.y=K),W<h.z?h.z=W:W>d.z&&(d.z=W))}s[L*4+0]=(A+w)*.5,s[L*4+1]=(D+M)*.5,s[L*4+2]=(R+P)*.5,s[L*4+3]=Math.sqrt((w-A)**2+(M-D)**2+(P-R)**2)*.5}}C.hasOwnProperty("mapping")&&(r=C.mapping?new Uint32Array(C.mapping):null,o=!0),C.cameraPosition&&(i=C.cameraPosition),C.cameraDirection&&(a=C.cameraDirection),S()})}var wd=class extends de{worker;target;orderData;centers;scene;uploadStream;pendingSorted=null;count=0;constructor(e,t){super(),this.scene=t??null,this.uploadStream=new to(e,!e.isWebGPU),this._deviceRestoredEvent=e.on("devicerestored",()=>{this.orderData&&(this.pendingSorted={count:this.count,data:new Uint32Array(this.orderData)},this.fire("updated"))});let s=a=>{let o=a.data??a;this.scene&&o.sortTime!==void 0&&this.scene.fire("gsplat:sorted",o.sortTime);let n=o.order,c=this.orderData;this.worker.postMessage({order:c},[c]),this.orderData=n,this.count=o.count,this.pendingSorted={count:o.count,data:new Uint32Array(n)},this.fire("updated")},r=Oe.environment==="node"?'require("node:worker_threads").parentPort':"self",i=`(${ET.toString()})(${r})`;Oe.environment==="node"?(this.worker=new Worker(i,{eval:!0}),this.worker.on("message",s)):(this.worker=new Worker(URL.createObjectURL(new Blob([i],{type:"application/javascript"}))),this.worker.addEventListener("message",s))}destroy(){this._deviceRestoredEvent.off(),this.worker.terminate(),this.worker=null,this.uploadStream.destroy(),this.uploadStream=null}init(e,t,s,r){this.target=e,this.centers=s.slice();let i=new Uint32Array(t);for(let n=0;n<t;++n)i[n]=n;this.orderData=new ArrayBuffer(t*4);let a={order:i.buffer,centers:s.buffer,chunks:r?.buffer},o=[i.buffer,s.buffer].concat(r?[r.buffer]:[]);this.worker.postMessage(a,o)}applyPendingSorted(){if(this.pendingSorted){let{count:e,data:t}=this.pendingSorted;return this.pendingSorted=null,this.uploadStream.upload(t,this.target),e}return-1}setMapping(e){if(e){let t=new Float32Array(e.length*3);for(let s=0;s<e.length;++s){let r=e[s]*3,i=s*3;t[i+0]=this.centers[r+0],t[i+1]=this.centers[r+1],t[i+2]=this.centers[r+2]}this.worker.postMessage({centers:t.buffer,mapping:e.buffer},[t.buffer,e.buffer])}else{let t=this.centers.slice();this.worker.postMessage({centers:t.buffer,mapping:null},[t.buffer])}}setCamera(e,t){this.worker.postMessage({cameraPosition:{x:e.x,y:e.y,z:e.z},cameraDirection:{x:t.x,y:t.y,z:t.z}})}};var mD=new N,so=new y,ro=new y,Md=class{resource;orderTexture;orderBuffer;_material;meshInstance;options={};sorter=null;lastCameraPosition=new y;lastCameraDirection=new y;cameras=[];constructor(e,t={}){this.resource=e;let s=e.device,r=e.streams.textureDimensions,i=r.x*r.y;if(s.isWebGPU?this.orderBuffer=new re(s,i*4,8):this.orderTexture=e.streams.createTexture("splatOrder",xt,r),t.material?(this._material=t.material,this._material.setDefine("{GSPLAT_INSTANCE_SIZE}",String(Ce.instanceSize)),this.setMaterialOrderData(this._material),this._material.setParameter("alphaClipForward",1/255)):(this._material=new st({uniqueName:"SplatMaterial",vertexGLSL:'#include "gsplatVS"',fragmentGLSL:'#include "gsplatPS"',vertexWGSL:'#include "gsplatVS"',fragmentWGSL:'#include "gsplatPS"',attributes:{vertex_position:le}}),this.configureMaterial(this._material),this._material.update()),e.ensureMesh(),this.meshInstance=new nt(e.mesh,this._material),this.meshInstance.setInstancing(!0,!0),this.meshInstance.gsplatInstance=this,this.meshInstance.instancingCount=0,e.hasCenters){let a=e.centers.slice(),o=e.chunks?.slice(),n=this.orderBuffer??this.orderTexture;this.sorter=new wd(s,t.scene),this.sorter.init(n,i,a,o)}}destroy(){this.resource?.releaseMesh(),this.orderTexture?.destroy(),this.orderBuffer?.destroy(),this.material?.destroy(),this.meshInstance?.destroy(),this.sorter?.destroy()}setMaterialOrderData(e){this.orderBuffer?e.setParameter("splatOrder",this.orderBuffer):(e.setParameter("splatOrder",this.orderTexture),e.setParameter("splatTextureSize",this.orderTexture.width))}set material(e){this._material!==e&&(this._material=e,this._material.setDefine("{GSPLAT_INSTANCE_SIZE}",String(Ce.instanceSize)),this.setMaterialOrderData(this._material),this._material.setParameter("alphaClipForward",1/255),this.meshInstance&&(this.meshInstance.material=e))}get material(){return this._material}configureMaterial(e,t={}){this.resource.configureMaterial(e,null,this.resource.format.getInputDeclarations()),e.setDefine("{GSPLAT_INSTANCE_SIZE}",Ce.instanceSize),e.setParameter("numSplats",0),this.setMaterialOrderData(e),e.setParameter("alphaClip",.3),e.setParameter("alphaClipForward",1/255),e.setParameter("minPixelSize",2),e.setDefine(`DITHER_${t.dither?"BLUENOISE":"NONE"}`,""),e.setDefine("STD_OPACITY_DITHER",t.dither?"BLUENOISE":void 0),e.cull=0,e.blendType=t.dither?tt:fs,e.depthWrite=!!t.dither}sort(e){if(this.sorter){let t=e.getWorldTransform();t.getTranslation(so),t.getZ(ro);let s=this.meshInstance.node.getWorldTransform(),r=mD.invert(s);r.transformPoint(so,so),r.transformVector(ro,ro),(!so.equalsApprox(this.lastCameraPosition)||!ro.equalsApprox(this.lastCameraDirection))&&(this.lastCameraPosition.copy(so),this.lastCameraDirection.copy(ro),this.sorter.setCamera(so,ro))}}update(){let e=this.sorter?.applyPendingSorted()??-1;if(e>=0&&(this.meshInstance.instancingCount=Math.ceil(e/Ce.instanceSize),this.material.setParameter("numSplats",e)),this.cameras.length>0){let t=this.cameras[0];this.sort(t._node),this.cameras.length=0}}};var pD=(l,e)=>{let t=[];for(let s=0;s<e;++s)t.push(l.getProp(`f_rest_${s}`));return t},Ld=class extends Ce{shBands;constructor(e,t,s={}){super(e,t,s);let r=t.numSplats;this.shBands=t.shBands;let i=[{name:"splatColor",format:ge},{name:"transformA",format:Je},{name:"transformB",format:ge}];this.shBands>0&&(i.push({name:"splatSH_1to3",format:Je}),this.shBands>1&&(i.push({name:"splatSH_4to7",format:Je}),this.shBands>2?(i.push({name:"splatSH_8to11",format:Je}),i.push({name:"splatSH_12to15",format:Je})):i.push({name:"splatSH_8to11",format:xt}))),this._format=new Gs(e,i,{readGLSL:'#include "gsplatUncompressedVS"',readWGSL:'#include "gsplatUncompressedVS"'}),this.streams.init(this.format,r),this.updateColorData(t),this.updateTransformData(t),this.shBands>0&&this.updateSHData(t)}configureMaterialDefines(e){e.set("SH_BANDS",this.shBands)}updateColorData(e){let t=this.streams.getTexture("splatColor");if(!t)return;let s=gs.float2Half,r=t.lock(),i=e.getProp("f_dc_0"),a=e.getProp("f_dc_1"),o=e.getProp("f_dc_2"),n=e.getProp("opacity"),c=e.activated,h=.28209479177387814;for(let d=0;d<this.numSplats;++d){let f=i[d]*h+.5,u=a[d]*h+.5,m=o[d]*h+.5,_=c?n[d]:1/(1+Math.exp(-n[d]));r[d*4+0]=s(f),r[d*4+1]=s(u),r[d*4+2]=s(m),r[d*4+3]=s(_)}t.unlock()}updateTransformData(e){let t=gs.float2Half,s=this.streams.getTexture("transformA"),r=this.streams.getTexture("transformB");if(!s)return;let i=s.lock(),a=new Float32Array(i.buffer),o=r.lock(),n=new y,c=new fe,h=new y,d=e.createIter(n,c,h);for(let f=0;f<this.numSplats;f++)d.read(f),c.normalize(),c.w<0&&c.mulScalar(-1),a[f*4+0]=n.x,a[f*4+1]=n.y,a[f*4+2]=n.z,i[f*4+3]=t(c.x)|t(c.y)<<16,o[f*4+0]=t(h.x),o[f*4+1]=t(h.y),o[f*4+2]=t(h.z),o[f*4+3]=t(c.z);s.unlock(),r.unlock()}updateSHData(e){let t=this.streams.getTexture("splatSH_1to3"),s=this.streams.getTexture("splatSH_4to7"),r=this.streams.getTexture("splatSH_8to11"),i=this.streams.getTexture("splatSH_12to15"),a=t.lock(),o=s?.lock(),n=r?.lock(),c=i?.lock(),h={1:3,2:8,3:15}[this.shBands],d=pD(e,h*3),f=2047,u=1023,m=new Float32Array(1),_=new Uint32Array(m.buffer),p=new Array(h*3).fill(0);for(let g=0;g<e.numSplats;++g){for(let S=0;S<h;++S)p[S*3]=d[S][g],p[S*3+1]=d[S+h][g],p[S*3+2]=d[S+h*2][g];let T=p[0];for(let S=1;S<h*3;++S)T=Math.max(T,Math.abs(p[S]));if(T!==0){for(let S=0;S<h;++S)p[S*3+0]=Math.max(0,Math.min(f,Math.floor((p[S*3+0]/T*.5+.5)*f+.5))),p[S*3+1]=Math.max(0,Math.min(u,Math.floor((p[S*3+1]/T*.5+.5)*u+.5))),p[S*3+2]=Math.max(0,Math.min(f,Math.floor((p[S*3+2]/T*.5+.5)*f+.5)));m[0]=T,a[g*4+0]=_[0],a[g*4+1]=p[0]<<21|p[1]<<11|p[2],a[g*4+2]=p[3]<<21|p[4]<<11|p[5],a[g*4+3]=p[6]<<21|p[7]<<11|p[8],this.shBands>1&&(o[g*4+0]=p[9]<<21|p[10]<<11|p[11],o[g*4+1]=p[12]<<21|p[13]<<11|p[14],o[g*4+2]=p[15]<<21|p[16]<<11|p[17],o[g*4+3]=p[18]<<21|p[19]<<11|p[20],this.shBands>2?(n[g*4+0]=p[21]<<21|p[22]<<11|p[23],n[g*4+1]=p[24]<<21|p[25]<<11|p[26],n[g*4+2]=p[27]<<21|p[28]<<11|p[29],n[g*4+3]=p[30]<<21|p[31]<<11|p[32],c[g*4+0]=p[33]<<21|p[34]<<11|p[35],c[g*4+1]=p[36]<<21|p[37]<<11|p[38],c[g*4+2]=p[39]<<21|p[40]<<11|p[41],c[g*4+3]=p[42]<<21|p[43]<<11|p[44]):n[g]=p[21]<<21|p[22]<<11|p[23])}}t.unlock(),s?.unlock(),r?.unlock(),i?.unlock()}};var yT=`
flat varying {type} user_{name};
void set{funcName}({type} value) { user_{name} = value; }
`;var CT=`
flat varying {type} user_{name};
{type} get{funcName}() { return user_{name}; }
`;var _D={[_e]:["float","vec2","vec3","vec4"],[pe]:["int","ivec2","ivec3","ivec4"],[Qe]:["uint","uvec2","uvec3","uvec4"]},gD={[_e]:["f32","vec2f","vec3f","vec4f"],[pe]:["i32","vec2i","vec3i","vec4i"],[Qe]:["u32","vec2u","vec3u","vec4u"]},SD=["x","y","z","w"];var vT=/\{name\}/g,TD=/\{type\}/g,ED=/\{funcName\}/g,yD=/\{word\}/g,xT=/\{value\}/g,CD=["gsplatUserVaryingsVS","gsplatUserVaryingsPS"],vD=["gsplatUserVaryingsVS","gsplatUserVaryingsFlushVS","gsplatUserVaryingsCS","gsplatUserVaryingsPS","gsplatUserCacheWriteCS","gsplatUserCacheReadVS"],xD=l=>l.charAt(0).toUpperCase()+l.slice(1),AD=(l,e)=>l===Qe?e:`bitcast<u32>(${e})`,RD=(l,e)=>l===Qe?e:l===pe?`bitcast<i32>(${e})`:`bitcast<f32>(${e})`,bd=class{_device;_streams=[];_words=0;_version=0;constructor(e){this._device=e}get streams(){return this._streams}get words(){return this._words}get version(){return this._version}add(e){for(let t of e)this._streams.push({name:t.name,type:t.type,components:t.components});this._changed()}remove(e){let t=this._streams.length;this._streams=this._streams.filter(s=>!e.includes(s.name)),this._streams.length!==t&&this._changed()}_changed(){this._words=this._streams.reduce((e,t)=>e+t.components,0),this._version++}_generateChunks(){let e=this._device.isWebGPU,t=e?gD:_D,s=e?"":yT,r=e?"":CT,i=[],a=[],o=[],n=[],c=[],h=[],d=0;for(let u of this._streams){let{name:m,type:_,components:p}=u,g=t[_][p-1],T=xD(m),S=x=>x.replace(vT,m).replace(TD,g).replace(ED,T);if(i.push(S(s)),a.push(S(r)),e){o.push(S("")),n.push(S(""));let x=[];for(let C=0;C<p;C++){let E=p===1?`_user_${m}`:`_user_${m}.${SD[C]}`;c.push("".replace(yD,String(8+d+C)).replace(xT,AD(_,E))),x.push(RD(_,`projCache[base + ${8+d+C}u]`))}h.push("".replace(vT,m).replace(xT,p===1?x[0]:`${g}(${x.join(", ")})`))}d+=p}let f={gsplatUserVaryingsVS:i.join(""),gsplatUserVaryingsPS:a.join("")};return e&&(f.gsplatUserVaryingsFlushVS=o.join(""),f.gsplatUserVaryingsCS=n.join(""),f.gsplatUserCacheWriteCS=c.join(""),f.gsplatUserCacheReadVS=h.join("")),f}apply(e){let t=this._device.isWebGPU,s=e.getShaderChunks(t?q:ce);if(e.setDefine("GSPLAT_USER_VARYINGS",this._streams.length>0),this._streams.length>0){let r=this._generateChunks();for(let i in r)s.set(i,r[i])}else(t?vD:CD).forEach(i=>s.delete(i));e.update()}};var AT="NONE",RT="FILL_WINDOW",_p="KEEP_ASPECT",gp="AUTO",Fd="FIXED";var PT;function Vs(){return PT}function Od(l){PT=l}var DT=!1,IT={app:null,createLoadingScreen(l){if(DT)return;DT=!0;let e=Vs();l(e)}};var On=class extends Dt{children=[];constructor(e){super(e),this.name="FramePassMultiView"}addChild(e){this.children.push(e)}render(){if(!this.enabled)return;let e=this.device,t=e.xrSubImages,s=t?.length??0,r=this.children,i=r.length;if(s===0){for(let h=0;h<i;h++)r[h].render();return}let a=e.backBuffer?.impl,o=e.xrColorTexture,n=a?.assignedColorTexture??null,c=a?.colorAttachments?.[0]?.format??null;for(let h=0;h<s;h++){let d=t[h];e.xrCurrentViewIndex=h,e.xrColorTexture=d.colorTexture,e.xrColorTextureViewDescriptor=d.viewDescriptor,a?.assignColorTexture?.(d.colorTexture,d.viewFormat);for(let f=0;f<i;f++)r[f].render()}e.xrCurrentViewIndex=-1,e.xrColorTextureViewDescriptor=null,e.xrColorTexture=o??null,a&&n&&c&&a.assignedColorTexture!==n&&a.assignColorTexture(n,c)}};var Nd=class{renderPasses=[];renderTargetMap=new Map;multiview=null;beginMultiView(e){this.multiview=new On(e)}endMultiView(){let e=this.multiview;this.multiview=null,e?.children.length&&this.renderPasses.push(e)}addRenderPass(e){e.frameUpdate();let t=e.beforePasses;for(let r=0;r<t.length;r++){let i=t[r];i.enabled&&this.addRenderPass(i)}e.enabled&&(this.multiview?this.multiview.addChild(e):this.renderPasses.push(e));let s=e.afterPasses;for(let r=0;r<s.length;r++){let i=s[r];i.enabled&&this.addRenderPass(i)}}reset(){this.renderPasses.length=0}compile(){this._compilePasses(this.renderPasses);for(let e=0;e<this.renderPasses.length;e++){let t=this.renderPasses[e];t instanceof On&&this._compilePasses(t.children)}}_compilePasses(e){let t=this.renderTargetMap;for(let i=0;i<e.length;i++){let a=e[i];a._skipStart=!1,a._skipEnd=!1;let o=a.renderTarget;if(o!==void 0){let n=t.get(o);if(n){let c=a.colorArrayOps.length;for(let h=0;h<c;h++)a.colorArrayOps[h].clear||(n.colorArrayOps[h].store=!0);a.depthStencilOps.clearDepth||(n.depthStencilOps.storeDepth=!0),a.depthStencilOps.clearStencil||(n.depthStencilOps.storeStencil=!0)}t.set(o,a)}}for(let i=0;i<e.length-1;i++){let a=e[i],o=a.renderTarget,n=e[i+1],c=n.renderTarget;o!==c||o===void 0||n.depthStencilOps.clearDepth||n.depthStencilOps.clearStencil||n.colorArrayOps.some(h=>h.clear)||a.afterPasses.length>0||n.beforePasses.length>0||(a._skipEnd=!0,n._skipStart=!0)}let s=null,r=null;for(let i=0;i<e.length;i++){let a=e[i],o=a.renderTarget,n=o?.colorBuffer;if(n?.cubemap){if(s===n){let c=r.colorArrayOps.length;for(let h=0;h<c;h++)r.colorArrayOps[h].mipmaps=!1}s=o.colorBuffer,r=a}else a.requiresCubemaps&&(s=null,r=null)}t.clear()}render(e){this.compile();let t=this.renderPasses;for(let s=0;s<t.length;s++)t[s].render()}};var Sp=class{constructor(e,t){this.texture0=e,this.texture1=t}destroy(){this.texture0?.destroy(),this.texture1?.destroy()}},wT=new Se,Nn=class l{static createTexture(e,t,s,r=""){return new se(e,{name:`AreaLightLUT${r}`,width:s,height:s,format:t,addressU:1,addressV:1,type:At,magFilter:1,minFilter:0,anisotropy:1,mipmaps:!1})}static applyTextures(e,t,s){wT.remove(e),wT.get(e,()=>new Sp(t,t===s?null:s)),e.scope.resolve("areaLightsLutTex1").setValue(t),e.scope.resolve("areaLightsLutTex2").setValue(s)}static createPlaceholder(e){let t=l.createTexture(e,ge,2,"placeholder");t.lock().fill(0),t.unlock(),l.applyTextures(e,t,t)}static set(e,t,s){function r(f,u,m){let _=l.createTexture(f,m,64);return _.lock().set(u),_.unlock(),_}function i(f){let u=f.length,m=new Uint16Array(u),_=gs.float2Half;for(let p=0;p<u;p++)m[p]=_(f[p]);return m}let a=t,o=s,n=i(a),c=i(o),h=r(e,n,ge),d=r(e,c,ge);l.applyTextures(e,h,d)}};var ao="en-US",oo={en:"en-US",es:"es-ES",zh:"zh-CN","zh-HK":"zh-TW","zh-TW":"zh-HK","zh-MO":"zh-HK",fr:"fr-FR",de:"de-DE",it:"it-IT",ru:"ru-RU",ja:"ja-JP"};var Tp={};function ei(l,e){for(let t=0,s=l.length;t<s;t++)Tp[l[t]]=e}function zs(l){let e=l.indexOf("-");return e!==-1?l.substring(0,e):l}function MT(l,e){let t=l.indexOf("-");return t!==-1?e+l.substring(t):e}function Bd(l,e){if(e[l])return l;let t=oo[l];if(t&&e[t])return t;let s=zs(l);return t=oo[s],e[t]?t:e[s]?s:ao}ei(["ja","ko","th","vi","zh","id"],l=>0);ei(["fa","hi"],l=>l>=0&&l<=1?0:1);ei(["fr","pt"],l=>l>=0&&l<2?0:1);ei(["da"],l=>l===1||!Number.isInteger(l)&&l>=0&&l<=1?0:1);ei(["de","en","it","el","es","tr","fi","sv","nb","no","ur"],l=>l===1?0:1);ei(["ru","uk"],l=>{if(Number.isInteger(l)){let e=l%10,t=l%100;if(e===1&&t!==11)return 0;if(e>=2&&e<=4&&(t<12||t>14))return 1;if(e===0||e>=5&&e<=9||t>=11&&t<=14)return 2}return 3});ei(["pl"],l=>{if(Number.isInteger(l)){if(l===1)return 0;let e=l%10,t=l%100;if(e>=2&&e<=4&&(t<12||t>14))return 1;if(e>=0&&e<=1||e>=5&&e<=9||t>=12&&t<=14)return 2}return 3});ei(["ar"],l=>{if(l===0)return 0;if(l===1)return 1;if(l===2)return 2;if(Number.isInteger(l)){let e=l%100;if(e>=3&&e<=10)return 3;if(e>=11&&e<=99)return 4}return 5});var PD=Tp[zs(ao)];function Ud(l){return Tp[l]||PD}var Bn=new RegExp("^\\s*(?:(?:[a-z]+[a-z0-9\\-+.]*:)?//|data:|blob:)","i");var kd=class{constructor(e="",t="",s=null,r=null,i=null,a=null){this.url=e,this.filename=t,this.hash=s,this.size=r,this.opt=i,this.contents=a}equals(e){return this.url===e.url&&this.filename===e.filename&&this.hash===e.hash&&this.size===e.size&&this.opt===e.opt&&this.contents===e.contents}};var DD=-1,ID={pvr:"extCompressedTexturePVRTC",dxt:"extCompressedTextureS3TC",etc2:"extCompressedTextureETC",etc1:"extCompressedTextureETC1",basis:"canvas"},LT=["pvr","dxt","etc2","etc1","basis"],is=class extends de{static EVENT_LOAD="load";static EVENT_UNLOAD="unload";static EVENT_REMOVE="remove";static EVENT_ERROR="error";static EVENT_CHANGE="change";static EVENT_PROGRESS="progress";static EVENT_ADDLOCALIZED="add:localized";static EVENT_REMOVELOCALIZED="remove:localized";_file=null;_i18n={};_preload=!1;_resources=[];id=DD--;loaded=!1;loading=!1;options={};registry=null;tags=new Bi(this);type;urlObject=null;constructor(e,t,s,r={},i={}){super(),this._name=e||"",this.type=t,this._data=r||{},this.options=i||{},s&&(this.file=s)}set name(e){if(this._name===e)return;let t=this._name;this._name=e,this.fire("name",this,this._name,t)}get name(){return this._name}set file(e){if(e&&e.variants&&["texture","textureatlas","bundle"].indexOf(this.type)!==-1){let r=this.registry?._loader?._app||Vs(),i=r?.graphicsDevice;if(i)for(let a=0,o=LT.length;a<o;a++){let n=LT[a];if(e.variants[n]&&i[ID[n]]){e=e.variants[n];break}if(r.enableBundles){let c=r.bundles.listBundlesForAsset(this);if(c&&c.find(h=>h?.file?.variants[n]))break}}}let t=this._file,s=e?new kd(e.url,e.filename,e.hash,e.size,e.opt,e.contents):null;(!!s!=!!t||s&&!s.equals(t))&&(this._file=s,this.fire("change",this,"file",s,t),this.reload())}get file(){return this._file}set data(e){let t=this._data;this._data=e,e!==t&&(this.fire("change",this,"data",e,t),this.loaded&&this.registry._loader.patch(this,this.registry))}get data(){return this._data}set resource(e){let t=this._resources[0];this._resources[0]=e,this.fire("change",this,"resource",e,t)}get resource(){return this._resources[0]}set resources(e){let t=this._resources;this._resources=e,this.fire("change",this,"resources",e,t)}get resources(){return this._resources}set preload(e){e=!!e,this._preload!==e&&(this._preload=e,this._preload&&!this.loaded&&!this.loading&&this.registry&&this.registry.load(this))}get preload(){return this._preload}set loadFaces(e){e=!!e,(!this.hasOwnProperty("_loadFaces")||e!==this._loadFaces)&&(this._loadFaces=e,this.loaded&&this.registry._loader.patch(this,this.registry))}get loadFaces(){return this._loadFaces}getFileUrl(){let e=this.file;if(!e||!e.url)return null;let t=e.url;if(this.registry&&this.registry.prefix&&!Bn.test(t)&&(t=this.registry.prefix+t),this.type!=="script"&&e.hash){let s=t.indexOf("?")!==-1?"&":"?";t+=`${s}t=${e.hash}`}return t}getAbsoluteUrl(e){if(e.startsWith("blob:")||e.startsWith("data:"))return e;let t=oe.getDirectory(this.file.url);return oe.join(t,e)}getLocalizedAssetId(e){return e=Bd(e,this._i18n),this._i18n[e]||null}addLocalizedAssetId(e,t){this._i18n[e]=t,this.fire("add:localized",e,t)}removeLocalizedAssetId(e){let t=this._i18n[e];t&&(delete this._i18n[e],this.fire("remove:localized",e,t))}ready(e,t){t=t||this,this.loaded?e.call(t,this):this.once("load",s=>{e.call(t,s)})}reload(){this.loaded&&(this.loaded=!1,this.registry.load(this))}unload(){if(!this.loaded&&!this.loading&&this._resources.length===0)return;this.fire("unload",this),this.registry?.fire(`unload:${this.id}`,this);let e=this._resources;this.urlObject&&(URL.revokeObjectURL(this.urlObject),this.urlObject=null),this.resources=[],this.loaded=!1,this.file&&this.registry?._loader.clearCache(this.getFileUrl(),this.type);for(let t=0;t<e.length;++t)e[t]?.destroy?.()}static fetchArrayBuffer(e,t,s,r=0){s?.file?.contents?setTimeout(()=>{t(null,s.file.contents)}):Zt.get(e,{cache:!0,responseType:"arraybuffer",retry:r>0,maxRetries:r,progress:s},t)}};var Gd=class{_index={};_key;constructor(e=null){this._key=e}addItem(e){let t=e.tags._list;for(let s of t)this.add(s,e)}removeItem(e){let t=e.tags._list;for(let s of t)this.remove(s,e)}add(e,t){this._index[e]&&this._index[e].list.indexOf(t)!==-1||(this._index[e]||(this._index[e]={list:[]},this._key&&(this._index[e].keys={})),this._index[e].list.push(t),this._key&&(this._index[e].keys[t[this._key]]=t))}remove(e,t){if(!this._index[e]||this._key&&!this._index[e].keys[t[this._key]])return;let s=this._index[e].list.indexOf(t);s!==-1&&(this._index[e].list.splice(s,1),this._key&&delete this._index[e].keys[t[this._key]],this._index[e].list.length===0&&delete this._index[e])}find(e){let t={},s=[],r,i,a,o,n,c=(h,d)=>this._index[h].list.length-this._index[d].list.length;for(let h=0;h<e.length;h++){if(i=e[h],i instanceof Array){if(i.length===0)continue;if(i.length===1)i=i[0];else{n=!1;for(let d=0;d<i.length;d++)if(!this._index[i[d]]){n=!0;break}if(n)continue;a=i.slice(0).sort(c),o=a.slice(1),o.length===1&&(o=o[0]);for(let d=0;d<this._index[a[0]].list.length;d++)r=this._index[a[0]].list[d],(this._key?!t[r[this._key]]:s.indexOf(r)===-1)&&r.tags.has(o)&&(this._key&&(t[r[this._key]]=!0),s.push(r));continue}}if(i&&typeof i=="string"&&this._index[i])for(let d=0;d<this._index[i].list.length;d++)r=this._index[i].list[d],this._key?t[r[this._key]]||(t[r[this._key]]=!0,s.push(r)):s.indexOf(r)===-1&&s.push(r)}return s}};var Vd=class extends de{static EVENT_LOAD="load";static EVENT_ADD="add";static EVENT_REMOVE="remove";static EVENT_ERROR="error";_assets=new Set;_loader;_idToAsset=new Map;_urlToAsset=new Map;_nameToAsset=new Map;_tags=new Gd("id");prefix=null;bundles=null;constructor(e){super(),this._loader=e}get loader(){return this._loader}list(e={}){let t=Array.from(this._assets);return e.preload!==void 0?t.filter(s=>s.preload===e.preload):t}add(e){this._assets.has(e)||(this._assets.add(e),this._idToAsset.set(e.id,e),e.file?.url&&this._urlToAsset.set(e.file.url,e),this._nameToAsset.has(e.name)||this._nameToAsset.set(e.name,new Set),this._nameToAsset.get(e.name).add(e),e.on("name",this._onNameChange,this),e.registry=this,this._tags.addItem(e),e.tags.on("add",this._onTagAdd,this),e.tags.on("remove",this._onTagRemove,this),this.fire("add",e),this.fire(`add:${e.id}`,e),e.file?.url&&this.fire(`add:url:${e.file.url}`,e),e.preload&&this.load(e))}remove(e){if(!this._assets.has(e))return!1;if(this._assets.delete(e),this._idToAsset.delete(e.id),e.file?.url&&this._urlToAsset.delete(e.file.url),e.off("name",this._onNameChange,this),this._nameToAsset.has(e.name)){let t=this._nameToAsset.get(e.name);t.delete(e),t.size===0&&this._nameToAsset.delete(e.name)}return this._tags.removeItem(e),e.tags.off("add",this._onTagAdd,this),e.tags.off("remove",this._onTagRemove,this),e.fire("remove",e),this.fire("remove",e),this.fire(`remove:${e.id}`,e),e.file?.url&&this.fire(`remove:url:${e.file.url}`,e),!0}destroy(){for(let e of this._assets)e.off("name",this._onNameChange,this),e.tags.off("add",this._onTagAdd,this),e.tags.off("remove",this._onTagRemove,this),e.registry===this&&(e.registry=null);this._assets.clear(),this._idToAsset.clear(),this._urlToAsset.clear(),this._nameToAsset.clear(),this._tags=null,this.bundles=null,this.off()}get(e){return this._idToAsset.get(Number(e))}getByUrl(e){return this._urlToAsset.get(e)}load(e,t){if((e.loading||e.loaded)&&!t?.force)return;let s=e.file,r=()=>{this.fire("load",e),this.fire(`load:${e.id}`,e),s&&s.url&&this.fire(`load:url:${s.url}`,e),e.fire("load",e)},i=o=>{if(o instanceof Array?e.resources=o:e.resource=o,this._loader.patch(e,this),e.type==="bundle"){let n=e.data.assets;for(let h=0;h<n.length;h++){let d=this._idToAsset.get(n[h]);d&&!d.loaded&&this.load(d,{force:!0})}let c=e.resource;c.loaded?r():(this.fire("load:start",e),this.fire(`load:start:${e.id}`,e),s&&s.url&&this.fire(`load:start:url:${s.url}`,e),e.fire("load:start",e),c.on("load",r))}else r()},a=(o,n,c)=>{if(e.loaded=!0,e.loading=!1,o)this.fire("error",o,e),this.fire(`error:${e.id}`,o,e),e.fire("error",o,e);else{if(e.type==="script"){let h=this._loader.getHandler("script");h._cache[e.id]&&h._cache[e.id].parentNode===document.head&&document.head.removeChild(h._cache[e.id]),c&&(h._cache[e.id]=c)}i(n)}};if(s||e.type==="cubemap"||e.type==="render"&&e.data.containerAsset){this.fire("load:start",e),this.fire(`load:${e.id}:start`,e),e.loading=!0;let o=e.getFileUrl();if(e.type==="bundle"){let n=e.data.assets;for(let c=0;c<n.length;c++){let h=this._idToAsset.get(n[c]);h&&(h.loaded||h.resource||h.loading||(h.loading=!0))}}this._loader.load(o,e.type,a,e,t)}else{let o=this._loader.open(e.type,e.data);e.loaded=!0,i(o)}}loadFromUrl(e,t,s){this.loadFromUrlAndFilename(e,null,t,s)}loadFromUrlAndFilename(e,t,s,r){let i=oe.getBasename(t||e),a={filename:t||i,url:e},o=this.getByUrl(e);if(!o)o=new is(i,s,a),this.add(o);else if(o.loaded){r(o.loadFromUrlError||null,o);return}let n=c=>{c.once("load",h=>{s==="material"?this._loadTextures(h,(d,f)=>{r(d,h)}):r(null,h)}),c.once("error",h=>{h&&(this.loadFromUrlError=h),r(h,c)}),this.load(c)};o.resource?r(null,o):s==="model"?this._loadModel(o,n):n(o)}_loadModel(e,t){let s=e.getFileUrl(),r=oe.getExtension(s);if(r===".json"||r===".glb"){let i=oe.getDirectory(s),a=oe.getBasename(s),o=oe.join(i,a.replace(r,".mapping.json"));this._loader.load(o,"json",(n,c)=>{n?(e.data={mapping:[]},t(e)):this._loadMaterials(e,c,(h,d)=>{e.data=c,t(e)})})}else t(e)}_loadMaterials(e,t,s){let r=[],i=0,a=(o,n)=>{this._loadTextures(n,(c,h)=>{r.push(n),r.length===i&&s(null,r)})};for(let o=0;o<t.mapping.length;o++){let n=t.mapping[o].path;if(n){i++;let c=e.getAbsoluteUrl(n);this.loadFromUrl(c,"material",a)}}i===0&&s(null,r)}_loadTextures(e,t){let s=[],r=0,i=e.data;if(i.mappingFormat!=="path"){t(null,s);return}let a=(n,c)=>{n&&console.error(`Failed to load material texture for "${e.name}": ${n?.message??n}`,n),s.push(c),s.length===r&&t(null,s)},o=En;for(let n=0;n<o.length;n++){let c=i[o[n]];if(c&&typeof c=="string"){r++;let h=e.getAbsoluteUrl(c);this.loadFromUrl(h,"texture",a)}}r===0&&t(null,s)}_onTagAdd(e,t){this._tags.add(e,t)}_onTagRemove(e,t){this._tags.remove(e,t)}_onNameChange(e,t,s){if(this._nameToAsset.has(s)){let r=this._nameToAsset.get(s);r.delete(e),r.size===0&&this._nameToAsset.delete(s)}this._nameToAsset.has(e.name)||this._nameToAsset.set(e.name,new Set),this._nameToAsset.get(e.name).add(e)}findByTag(...e){return this._tags.find(e)}filter(e){return Array.from(this._assets).filter(t=>e(t))}find(e,t){let s=this._nameToAsset.get(e);if(!s)return null;for(let r of s)if(!t||r.type===t)return r;return null}findAll(e,t){let s=this._nameToAsset.get(e);if(!s)return[];let r=Array.from(s);return t?r.filter(i=>i.type===t):r}log(){}getAssetById(e){return this.get(e)}};var zd=class{_idToBundle=new Map;_assetToBundles=new Map;_urlsToBundles=new Map;_fileRequests=new Map;constructor(e){this._assets=e,this._assets.bundles=this,this._assets.on("add",this._onAssetAdd,this),this._assets.on("remove",this._onAssetRemove,this)}_onAssetAdd(e){if(e.type==="bundle"){this._idToBundle.set(e.id,e),this._assets.on(`load:start:${e.id}`,this._onBundleLoadStart,this),this._assets.on(`load:${e.id}`,this._onBundleLoad,this),this._assets.on(`error:${e.id}`,this._onBundleError,this);let t=e.data.assets;for(let s=0;s<t.length;s++)this._indexAssetInBundle(t[s],e)}else this._assetToBundles.has(e.id)&&this._indexAssetFileUrls(e)}_unbindAssetEvents(e){this._assets.off(`load:start:${e}`,this._onBundleLoadStart,this),this._assets.off(`load:${e}`,this._onBundleLoad,this),this._assets.off(`error:${e}`,this._onBundleError,this)}_indexAssetInBundle(e,t){let s=this._assetToBundles.get(e);s||(s=new Set,this._assetToBundles.set(e,s)),s.add(t);let r=this._assets.get(e);r&&this._indexAssetFileUrls(r)}_indexAssetFileUrls(e){let t=this._getAssetFileUrls(e);if(t)for(let s=0;s<t.length;s++){let r=this._assetToBundles.get(e.id);r&&this._urlsToBundles.set(t[s],r)}}_getAssetFileUrls(e){let t=e.getFileUrl();if(!t)return null;t=t.split("?")[0];let s=[t];if(e.type==="font"){let r=e.data.info.maps.length;for(let i=1;i<r;i++)s.push(t.replace(".png",`${i}.png`))}return s}_onAssetRemove(e){if(e.type==="bundle"){this._idToBundle.delete(e.id),this._unbindAssetEvents(e.id);let t=e.data.assets;for(let s=0;s<t.length;s++){let r=this._assetToBundles.get(t[s]);if(r&&(r.delete(e),r.size===0)){this._assetToBundles.delete(t[s]);for(let[i,a]of this._urlsToBundles)a===r&&this._urlsToBundles.delete(i)}}this._onBundleError(`Bundle ${e.id} was removed`)}else{if(!this._assetToBundles.get(e.id))return;this._assetToBundles.delete(e.id);let s=this._getAssetFileUrls(e);if(!s)return;for(let r=0;r<s.length;r++)this._urlsToBundles.delete(s[r])}}_onBundleLoadStart(e){e.resource.on("add",(t,s)=>{let r=this._fileRequests.get(t);if(r){for(let i=0;i<r.length;i++)r[i](null,s);this._fileRequests.delete(t)}})}_onBundleLoad(e){if(!e.resource){this._onBundleError(`Bundle ${e.id} failed to load`);return}if(this._fileRequests)for(let[t,s]of this._fileRequests){let r=this._urlsToBundles.get(t);if(!r||!r.has(e))continue;let i=decodeURIComponent(t),a,o;if(e.resource.has(i))o=e.resource.get(i);else if(e.resource.loaded)a=`Bundle ${e.id} does not contain URL ${t}`;else continue;for(let n=0;n<s.length;n++)s[n](a,a||o);this._fileRequests.delete(t)}}_onBundleError(e){for(let[t,s]of this._fileRequests)if(!this._findLoadedOrLoadingBundleForUrl(t)){for(let i=0;i<s.length;i++)s[i](e);this._fileRequests.delete(t)}}_findLoadedOrLoadingBundleForUrl(e){let t=this._urlsToBundles.get(e);if(!t)return null;let s=null;for(let r of t){if(r.loaded&&r.resource)return r;r.loading&&(s=r)}return s}listBundlesForAsset(e){let t=this._assetToBundles.get(e.id);return t?Array.from(t):null}list(){return Array.from(this._idToBundle.values())}hasUrl(e){return this._urlsToBundles.has(e)}urlIsLoadedOrLoading(e){return!!this._findLoadedOrLoadingBundleForUrl(e)}loadUrl(e,t){let s=this._findLoadedOrLoadingBundleForUrl(e);if(!s){t(`URL ${e} not found in any bundles`);return}if(s.loaded){let i=decodeURIComponent(e),a=s.resource;if(a.has(i)){t(null,a.get(i));return}else if(a.loaded){t(`Bundle ${s.id} does not contain URL ${e}`);return}}let r=this._fileRequests.get(e);r||(r=[],this._fileRequests.set(e,r)),r.push(t)}destroy(){this._assets.off("add",this._onAssetAdd,this),this._assets.off("remove",this._onAssetRemove,this);for(let e of this._idToBundle.keys())this._unbindAssetEvents(e);this._assets=null,this._idToBundle.clear(),this._idToBundle=null,this._assetToBundles.clear(),this._assetToBundles=null,this._urlsToBundles.clear(),this._urlsToBundles=null,this._fileRequests.clear(),this._fileRequests=null}};var Hd=class extends de{anim;animation;audiolistener;button;camera;collision;element;gsplat;joint;layoutchild;layoutgroup;light;model;particlesystem;render;rigidbody;screen;script;scrollbar;scrollview;sound;sprite;zone;constructor(){super(),this.list=[]}add(e){let t=e.id;if(this[t])throw new Error(`ComponentSystem name '${t}' already registered or not allowed`);this[t]=e,this.list.push(e)}remove(e){let t=e.id;if(!this[t])throw new Error(`No ComponentSystem named '${t}' registered`);let s=this.list.indexOf(this[t]);s!==-1&&this.list.splice(s,1),delete this[t]}destroy(){this.off();for(let e=0;e<this.list.length;e++)this.list[e].destroy()}};var Wd=class extends de{_index=new Map;_loaded=!1;static EVENT_ADD="add";static EVENT_LOAD="load";addFile(e,t){this._index.has(e)||(this._index.set(e,t),this.fire("add",e,t))}has(e){return this._index.has(e)}get(e){return this._index.get(e)||null}destroy(){this._index.clear()}set loaded(e){!e||this._loaded||(this._loaded=!0,this.fire("load"))}get loaded(){return this._loaded}};var Xd=class extends de{headerSize=512;paddingSize=512;bytesRead=0;bytesReceived=0;headerRead=!1;reader=null;data=new Uint8Array(0);decoder=null;prefix="";fileName="";fileSize=0;fileType="";ustarFormat="";constructor(e,t=""){super(),this.prefix=t||"",this.reader=e.body.getReader(),this.reader.read().then(s=>{this.pump(s.done,s.value)}).catch(s=>{this.fire("error",s)})}pump(e,t){if(e)return this.fire("done"),null;this.bytesReceived+=t.byteLength;let s=new Uint8Array(this.data.length+t.length);for(s.set(this.data),s.set(t,this.data.length),this.data=s;this.readFile(););return this.reader.read().then(r=>{this.pump(r.done,r.value)}).catch(r=>{this.fire("error",r)})}readFile(){if(!this.headerRead&&this.bytesReceived>this.bytesRead+this.headerSize){this.headerRead=!0;let e=new DataView(this.data.buffer,this.bytesRead,this.headerSize);this.decoder??(this.decoder=new TextDecoder("windows-1252"));let t=this.decoder.decode(e);if(this.fileName=t.substring(0,100).replace(/\0/g,""),this.fileSize=parseInt(t.substring(124,136),8),this.fileType=t.substring(156,157),this.ustarFormat=t.substring(257,263),this.ustarFormat.indexOf("ustar")!==-1){let s=t.substring(345,500).replace(/\0/g,"");s.length>0&&(this.fileName=s.trim()+this.fileName.trim())}this.bytesRead+=512}if(this.headerRead){if(this.bytesReceived<this.bytesRead+this.fileSize)return!1;if(this.fileType===""||this.fileType==="0"){let t=new DataView(this.data.buffer,this.bytesRead,this.fileSize),s={name:this.prefix+this.fileName,size:this.fileSize,data:t};this.fire("file",s)}this.bytesRead+=this.fileSize,this.headerRead=!1;let e=this.bytesRead%this.paddingSize;return e!==0&&(this.bytesRead+=this.paddingSize-e),!0}return!1}};var Yd=class{handlerType="";_app;_maxRetries=0;_parsers=[];constructor(e,t){this._app=e,this.handlerType=t}get app(){return this._app}set maxRetries(e){this._maxRetries=e}get maxRetries(){return this._maxRetries}addParser(e,t){!e||typeof e.canParse!="function"||(e.handler=this,this._parsers.push(e))}removeParser(e){let t=this._parsers.indexOf(e);t!==-1&&(this._parsers.splice(t,1),e.handler=null)}get parsers(){return this._parsers.slice()}fetch(e,t,s,r){if(typeof e=="string"&&(e={load:e,original:e}),t===gi.ResponseType.ARRAY_BUFFER){is.fetchArrayBuffer(e.load,s,r,this.maxRetries);return}Zt.get(e.load,{responseType:t,retry:this.maxRetries>0,maxRetries:this.maxRetries},s)}_makeContext(e,t){let s=e&&typeof e=="object"?e.original:e,r=s?s.split("?")[0]:"";return{url:s??null,ext:s?oe.getExtension(r).toLowerCase().replace(".",""):"",basename:s?oe.getBasename(r).toLowerCase():"",asset:t,app:this._app}}_selectParser(e){for(let t=this._parsers.length-1;t>=0;t--)if(this._parsers[t].canParse(e))return this._parsers[t];return null}load(e,t,s){if(this._parsers.length===0)return;typeof e=="string"&&(e={load:e,original:e});let r=this._makeContext(e,s),i=this._selectParser(r);if(!i){t(`No parser found for resource: ${r.url}`);return}i.load(e,t,s)}open(e,t,s){if(this._parsers.length===0)return t;let r=this._selectParser(this._makeContext(e,s));return r?.open?r.open(e,t,s):t}patch(e,t){}};var wD=5e3,jd=class extends Yd{constructor(e){super(e,"bundle"),this._assets=e.assets}_fetchRetries(e,t){return new Promise((s,r)=>{let i=0,a=()=>{fetch(e,t).then(s).catch(o=>{if(i<this.maxRetries){i++;let n=O.clamp(Math.pow(2,i)*gi.retryDelay,0,wD);setTimeout(a,n)}else r(o)})};a()})}load(e,t){typeof e=="string"&&(e={load:e,original:e}),this._fetchRetries(e.load,{mode:"cors",credentials:cg()}).then(s=>{if(!s.ok)throw new Error(`Error loading bundle: ${s.status} ${s.statusText}`);let r=new Wd;t(null,r);let i=new Xd(s,this._assets.prefix);i.on("file",a=>{r.addFile(a.name,a.data)}),i.on("done",()=>{r.loaded=!0}),i.on("error",a=>{t(a)})}).catch(s=>{t(s)})}open(e,t){return t}};var qd=class l{constructor(e){this._handlers={},this._requests={},this._cache={},this._app=e}addHandler(e,t){this._handlers[e]=t,t._loader=this}removeHandler(e){delete this._handlers[e]}getHandler(e){return this._handlers[e]}static makeKey(e,t){return`${e}-${t}`}load(e,t,s,r,i){let a=this._handlers[t];if(!a){let n=`No resource handler for asset type: '${t}' when loading [${e}]`;s(n);return}if(!e){this._loadNull(a,s,r);return}let o=l.makeKey(e,t);if(this._cache[o]!==void 0)s(null,this._cache[o]);else if(this._requests[o])this._requests[o].push(s);else{this._requests[o]=[s];let n=this,c=function(d,f){if(d){n._onFailure(o,d);return}if(f.load instanceof DataView){if(a.openBinary){if(!n._requests[o])return;try{let u=a.openBinary(f.load);n._onSuccess(o,u)}catch(u){n._onFailure(o,u)}return}f.load=URL.createObjectURL(new Blob([f.load])),r&&(r.urlObject&&URL.revokeObjectURL(r.urlObject),r.urlObject=f.load)}a.load(f,(u,m,_)=>{if(n._requests[o]){if(u){n._onFailure(o,u);return}try{n._onSuccess(o,a.open(f.original,m,r),_)}catch(p){n._onFailure(o,p)}}},r)},h=e.split("?")[0];if(this._app.enableBundles&&this._app.bundles.hasUrl(h)&&!(i&&i.bundlesIgnore)){if(!this._app.bundles.urlIsLoadedOrLoading(h)){let d=this._app.bundles.listBundlesForAsset(r),f;i&&i.bundlesFilter&&(f=i.bundlesFilter(d)),f||(d?.sort((u,m)=>u.file.size-m.file.size),f=d?.[0]),f&&this._app.assets?.load(f)}this._app.bundles.loadUrl(h,(d,f)=>{c(d,{load:f,original:h})})}else c(null,{load:e,original:r&&r.file.filename||e})}}_loadNull(e,t,s){let r=function(i,a,o){if(i)t(i);else try{t(null,e.open(null,a,s),o)}catch(n){t(n)}};e.load(null,r,s)}_onSuccess(e,t,s){t!==null?this._cache[e]=t:delete this._cache[e];for(let r=0;r<this._requests[e].length;r++)this._requests[e][r](null,t,s);delete this._requests[e]}_onFailure(e,t){if(console.error(`Failed to load resource [${e}]: ${t?.message??t}`,t),this._requests[e]){for(let s=0;s<this._requests[e].length;s++)this._requests[e][s](t);delete this._requests[e]}}open(e,t){let s=this._handlers[e];return s?s.open(null,t):(console.warn(`No resource handler found for: ${e}`),t)}patch(e,t){let s=this._handlers[e.type];if(!s){console.warn(`No resource handler found for: ${e.type}`);return}s.patch&&s.patch(e,t)}clearCache(e,t){let s=l.makeKey(e,t);delete this._cache[s]}getFromCache(e,t){let s=l.makeKey(e,t);if(this._cache[s])return this._cache[s]}enableRetry(e=5){e=Math.max(0,Math.floor(e))||0;for(let t in this._handlers)this._handlers[t].maxRetries=e}disableRetry(){for(let e in this._handlers)this._handlers[e].maxRetries=0}set maxConcurrentRequests(e){Zt.maxConcurrentRequests=Math.max(0,Math.floor(e))||0}get maxConcurrentRequests(){return Zt.maxConcurrentRequests}set withCredentials(e){Zt.withCredentials=!!e}get withCredentials(){return Zt.withCredentials}destroy(){this._handlers={},this._requests={},this._cache={},this._app=null}};var $d=class{_validate(e){if(!e.header)throw new Error('I18n#addData: Missing "header" field');if(!e.header.version)throw new Error('I18n#addData: Missing "header.version" field');if(e.header.version!==1)throw new Error('I18n#addData: Invalid "header.version" field');if(e.data){if(!Array.isArray(e.data))throw new Error('I18n#addData: "data" field must be an array')}else throw new Error('I18n#addData: Missing "data" field');for(let t=0,s=e.data.length;t<s;t++){let r=e.data[t];if(!r.info)throw new Error(`I18n#addData: missing "data[${t}].info" field`);if(!r.info.locale)throw new Error(`I18n#addData: missing "data[${t}].info.locale" field`);if(typeof r.info.locale!="string")throw new Error(`I18n#addData: "data[${t}].info.locale" must be a string`);if(!r.messages)throw new Error(`I18n#addData: missing "data[${t}].messages" field`)}}parse(e){return e.data}};var Kd=class l extends de{static EVENT_CHANGE="change";constructor(e){super(),this.locale=ao,this._translations={},this._availableLangs={},this._app=e,this._assets=[],this._parser=new $d}set assets(e){let t={};for(let r=0,i=e.length;r<i;r++){let a=e[r]instanceof is?e[r].id:e[r];t[a]=!0}let s=this._assets.length;for(;s--;){let r=this._assets[s];if(!t[r]){this._app.assets.off(`add:${r}`,this._onAssetAdd,this);let i=this._app.assets.get(r);i&&this._onAssetRemove(i),this._assets.splice(s,1)}}for(let r in t){let i=parseInt(r,10);if(this._assets.indexOf(i)!==-1)continue;this._assets.push(i);let a=this._app.assets.get(i);a?this._onAssetAdd(a):this._app.assets.once(`add:${i}`,this._onAssetAdd,this)}}get assets(){return this._assets}set locale(e){if(this._locale===e)return;let t=zs(e);if(t==="in"&&(t="id",e=MT(e,t),this._locale===e))return;let s=this._locale;this._locale=e,this._lang=t,this._pluralFn=Ud(this._lang),this.fire(l.EVENT_CHANGE,e,s)}get locale(){return this._locale}static findAvailableLocale(e,t){return Bd(e,t)}findAvailableLocale(e){if(this._translations[e])return e;let t=zs(e);return this._findFallbackLocale(e,t)}getText(e,t){let s=e,r;t||(t=this._locale,r=this._lang);let i=this._translations[t];return i||(r||(r=zs(t)),t=this._findFallbackLocale(t,r),i=this._translations[t]),i&&i.hasOwnProperty(e)&&(s=i[e],Array.isArray(s)&&(s=s[0]),s==null&&(s=e)),s}getPluralText(e,t,s){let r=e,i,a;s?(i=zs(s),a=Ud(i)):(s=this._locale,i=this._lang,a=this._pluralFn);let o=this._translations[s];if(o||(s=this._findFallbackLocale(s,i),i=zs(s),a=Ud(i),o=this._translations[s]),o&&o[e]&&a){let n=a(t);r=o[e][n],r==null&&(r=e)}return r}addData(e){let t;try{t=this._parser.parse(e)}catch(s){console.error(`I18n.addData: failed to parse localization data: ${s?.message??s}`,s);return}for(let s=0,r=t.length;s<r;s++){let i=t[s],a=i.info.locale,o=i.messages;if(!this._translations[a]){this._translations[a]={};let n=zs(a);this._availableLangs[n]||(this._availableLangs[n]=a)}Object.assign(this._translations[a],o),this.fire("data:add",a,o)}}removeData(e){let t;try{t=this._parser.parse(e)}catch(s){console.error(`I18n.removeData: failed to parse localization data: ${s?.message??s}`,s);return}for(let s=0,r=t.length;s<r;s++){let i=t[s],a=i.info.locale,o=this._translations[a];if(!o)continue;let n=i.messages;for(let c in n)delete o[c];Object.keys(o).length===0&&(delete this._translations[a],delete this._availableLangs[zs(a)]),this.fire("data:remove",a,n)}}destroy(){this._translations=null,this._availableLangs=null,this._assets=null,this._parser=null,this.off()}_findFallbackLocale(e,t){let s=oo[e];return s&&this._translations[s]||(s=oo[t],s&&this._translations[s])||(s=this._availableLangs[t],s&&this._translations[s])?s:ao}_onAssetAdd(e){e.on("load",this._onAssetLoad,this),e.on("change",this._onAssetChange,this),e.on("remove",this._onAssetRemove,this),e.on("unload",this._onAssetUnload,this),e.resource&&this._onAssetLoad(e)}_onAssetLoad(e){this.addData(e.resource)}_onAssetChange(e){e.resource&&this.addData(e.resource)}_onAssetRemove(e){e.off("load",this._onAssetLoad,this),e.off("change",this._onAssetChange,this),e.off("remove",this._onAssetRemove,this),e.off("unload",this._onAssetUnload,this),e.resource&&this.removeData(e.resource),this._app.assets.once(`add:${e.id}`,this._onAssetAdd,this)}_onAssetUnload(e){e.resource&&this.removeData(e.resource)}};var bT=new Set(["system","entity","create","destroy","swap","move","data","scripts","_scripts","_scriptsIndex","_scriptsData","_declarationOrder","enabled","_oldState","onEnable","onDisable","onPostStateChange","_onSetEnabled","_checkState","_onBeforeRemove","_onInitializeAttributes","_onInitialize","_onPostInitialize","_onUpdate","_onPostUpdate","_callbacks","_callbackActive","has","get","on","off","fire","once","hasEvent","worker"]);var MD=/^\s*function(?:\s|\s*\/\*.*\*\/\s*)+([^(\s\/]*)\s*/,LD=l=>l&&l[0].toLowerCase()+l.substring(1);function bD(l){if(typeof l!="function")return;if(Object.prototype.hasOwnProperty.call(l,"scriptName")&&l.scriptName)return l.scriptName;if("name"in Function.prototype)return l.name;if(l===Function||l===Function.prototype.constructor)return"Function";let e=`${l}`.match(MD);return e?e[1]:void 0}function FT(l){if(typeof l!="function")return;if(Object.prototype.hasOwnProperty.call(l,"__name")&&l.__name)return l.__name;if(Object.prototype.hasOwnProperty.call(l,"scriptName")&&l.scriptName)return l.scriptName;let e=bD(l);return e?LD(e):void 0}var Zd=class extends de{_scripts=new Map;_list=[];_scriptSchemas=new Map;constructor(e){super(),this.app=e}destroy(){this.app=null,this.off()}addSchema(e,t){t&&this._scriptSchemas.set(e,t)}getSchema(e){return this._scriptSchemas.get(e)}add(e){let t=FT(e);return!t||bT.has(t)?!1:(e.__name=t,this._scripts.has(t)?(setTimeout(()=>{if(e.prototype.swap){let s=this._scripts.get(t),r=this._list.indexOf(s);this._list[r]=e,this._scripts.set(t,e),this.fire("swap",t,e),this.fire(`swap:${t}`,e)}else console.warn(`script registry already has '${t}' script, define 'swap' method for new script type to enable code hot swapping`)}),!1):(this._scripts.set(t,e),this._list.push(e),this.fire("add",t,e),this.fire(`add:${t}`,e),setTimeout(()=>{if(!this._scripts.has(t)||!this.app||!this.app.systems||!this.app.systems.script)return;let s=this.app.systems.script._components,r=[],i=[];for(s.loopIndex=0;s.loopIndex<s.length;s.loopIndex++){let a=s.items[s.loopIndex],o=a._scriptsIndex[t];if(o&&o.awaiting){let n=a.create(t,{preloading:!0,ind:a._awaitingInsertIndex(t),enabled:o.enabled,attributes:o.attributes,properties:o.properties});n&&r.push(n);for(let c of a.scripts)a.initializeAttributes(c)}}for(let a=0;a<r.length;a++)r[a].enabled&&(r[a]._initialized=!0,i.push(r[a]),r[a].initialize&&r[a].initialize());for(let a=0;a<i.length;a++)!i[a].enabled||i[a]._postInitialized||(i[a]._postInitialized=!0,i[a].postInitialize&&i[a].postInitialize())}),!0))}remove(e){let t=e,s=e;if(typeof s!="string"?s=t.__name:t=this.get(s),this.get(s)!==t)return!1;this._scripts.delete(s);let r=this._list.indexOf(t);return this._list.splice(r,1),this.fire("remove",s,t),this.fire(`remove:${s}`,t),!0}get(e){return this._scripts.get(e)||null}has(e){if(typeof e=="string")return this._scripts.has(e);if(!e)return!1;let t=e.__name;return this._scripts.get(t)===e}list(){return this._list}};var FD=(l,e)=>l.constructor.order-e.constructor.order,OD=l=>l.sort(FD),Un=[],NT=[],ND=()=>NT.pop()??[],OT=l=>{l.length=0,NT.push(l)},as=class l extends wt{static EVENT_DESTROY="destroy";anim;animation;audiolistener;button;camera;collision;element;gsplat;joint;layoutchild;layoutgroup;light;model;particlesystem;render;rigidbody;screen;script;scrollbar;scrollview;sound;sprite;c={};_app;_destroying=!1;_guid=null;_template=!1;constructor(e,t=Vs()){super(e),this._app=t}addComponent(e,t){let s=this._app.systems[e];return!s||this.c[e]?null:s.addComponent(this,t)}removeComponent(e){let t=this._app.systems[e];t&&this.c[e]&&t.removeComponent(this)}findComponent(e){let t=this.findOne(s=>s.c?.[e]);return t&&t.c[e]}findComponents(e){return this.find(t=>t.c?.[e]).map(t=>t.c[e])}findScript(e){let t=this.findOne(s=>!!s.c?.script?.get(e));return t?t.c.script.get(e):void 0}findScripts(e){return this.find(s=>!!s.c?.script?.get(e)).map(s=>s.c.script.get(e))}set guid(e){let t=this._app._entityIndex;this._guid&&delete t[this._guid],this._guid=e,t[this._guid]=this}get guid(){return this._guid||(this.guid=l_.create()),this._guid}getGuid(){return this.guid}setGuid(e){this.guid=e}_notifyHierarchyStateChanged(e,t){let s=!1;e===this&&Un.length===0&&(s=!0),e._beingEnabled=!0,e._onHierarchyStateChanged(t),e._onHierarchyStatePostChanged&&Un.push(e);let r=e._children;for(let i=0,a=r.length;i<a;i++)r[i]._enabled&&this._notifyHierarchyStateChanged(r[i],t);if(e._beingEnabled=!1,s){for(let i=0;i<Un.length;i++)Un[i]._onHierarchyStatePostChanged();Un.length=0}}_onHierarchyStateChanged(e){super._onHierarchyStateChanged(e);let t=this._getSortedComponents();for(let s=0;s<t.length;s++){let r=t[s];r.enabled&&(e?r.onEnable():r.onDisable())}OT(t)}_onHierarchyStatePostChanged(){let e=this._getSortedComponents();for(let t=0;t<e.length;t++)e[t].onPostStateChange();OT(e)}findByGuid(e){if(this._guid===e)return this;let t=this._app._entityIndex[e];return t&&(t===this||t.isDescendantOf(this))?t:null}destroy(){this._destroying=!0;for(let e in this.c)this.c[e].enabled=!1;for(let e in this.c)this.c[e].system.removeComponent(this);super.destroy(),this._guid&&delete this._app._entityIndex[this._guid],this._destroying=!1}clone(){let e={},t=this._cloneRecursively(e);return e[this.guid]=t,BT(this,this,t,e),t}_getSortedComponents(){let e=this.c,t=ND(),s=0;for(let r in e)if(e.hasOwnProperty(r)){let i=e[r];s|=i.constructor.order!==0,t.push(i)}return s&&t.length>1&&OD(t),t}_cloneRecursively(e){let t=new this.constructor(void 0,this._app);super._cloneInternal(t);for(let s in this.c)this.c[s].system.cloneComponent(this,t);for(let s=0;s<this._children.length;s++){let r=this._children[s];if(r instanceof l){let i=r._cloneRecursively(e);t.addChild(i),e[r.guid]=i}}return t}};function BT(l,e,t,s){if(e instanceof as){let r=e.c;for(let o in r){let n=r[o],c=n.system.getPropertiesOfType("entity");for(let h=0,d=c.length;h<d;h++){let u=c[h].name,m=n[u];if(!!l.findByGuid(m)){let p=s[m].guid;p&&(t.c[o][u]=p)}}}r.script&&t.script.resolveDuplicatedEntityReferenceProperties(r.script,s),r.render&&t.render.resolveDuplicatedEntityReferenceProperties(r.render,s),r.button&&t.button.resolveDuplicatedEntityReferenceProperties(r.button,s),r.joint&&t.joint.resolveDuplicatedEntityReferenceProperties(r.joint,s),r.scrollview&&t.scrollview.resolveDuplicatedEntityReferenceProperties(r.scrollview,s),r.scrollbar&&t.scrollbar.resolveDuplicatedEntityReferenceProperties(r.scrollbar,s),r.anim&&t.anim.resolveDuplicatedEntityReferenceProperties(r.anim,s);let i=e.children.filter(o=>o instanceof as),a=t.children.filter(o=>o instanceof as);for(let o=0,n=i.length;o<n;o++)BT(l,i[o],a[o],s)}}var kn=class{name;url;data=null;_loading=!1;_onLoadedCallbacks=[];constructor(e,t){this.name=e,this.url=t}get loaded(){return!!this.data}get loading(){return this._loading}};var Qd=class{_app;_list=[];_index={};_urlIndex={};constructor(e){this._app=e}destroy(){this._app=null}list(){return this._list}add(e,t){if(this._index.hasOwnProperty(e))return!1;let s=new kn(e,t),r=this._list.push(s);return this._index[s.name]=r-1,this._urlIndex[s.url]=r-1,!0}find(e){return this._index.hasOwnProperty(e)?this._list[this._index[e]]:null}findByUrl(e){return this._urlIndex.hasOwnProperty(e)?this._list[this._urlIndex[e]]:null}remove(e){if(this._index.hasOwnProperty(e)){let t=this._index[e],s=this._list[t];delete this._urlIndex[s.url],delete this._index[e],this._list.splice(t,1);for(let r=0;r<this._list.length;r++)s=this._list[r],this._index[s.name]=r,this._urlIndex[s.url]=r}}_loadSceneData(e,t,s){let r=this._app,i=e;if(typeof e=="string"&&(e=this.findByUrl(i)||this.find(i)||new kn("Untitled",i)),i=e.url,!i){s("Cannot find scene to load");return}if(e.loaded){s(null,e);return}r.assets&&r.assets.prefix&&!Bn.test(i)&&(i=oe.join(r.assets.prefix,i)),e._onLoadedCallbacks.push(s),e._loading||r.loader.getHandler("hierarchy").load(i,(o,n)=>{e.data=n,e._loading=!1;for(let c=0;c<e._onLoadedCallbacks.length;c++)e._onLoadedCallbacks[c](o,e);t||(e.data=null),e._onLoadedCallbacks.length=0}),e._loading=!0}loadSceneData(e,t){this._loadSceneData(e,!0,t)}unloadSceneData(e){typeof e=="string"&&(e=this.findByUrl(e)),e&&(e.data=null)}_loadSceneHierarchy(e,t,s){this._loadSceneData(e,!1,(r,i)=>{if(r){s&&s(r);return}t&&t(i);let a=this._app,o=()=>{let n=a.loader.getHandler("hierarchy");a.systems.script.preloading=!0;let c=n.open(i.url,i.data);a.systems.script.preloading=!1,a.loader.clearCache(i.url,"hierarchy"),a.root.addChild(c),a.systems.fire("initialize",c),a.systems.fire("postInitialize",c),a.systems.fire("postPostInitialize",c),s&&s(null,c)};a._preloadScripts(i.data,o)})}loadSceneHierarchy(e,t){this._loadSceneHierarchy(e,null,t)}loadSceneSettings(e,t){this._loadSceneData(e,!1,(s,r)=>{s?t&&t(s):(this._app.applySceneSettings(r.data.settings),t&&t(null))})}changeScene(e,t){let s=this._app,r=i=>{let{children:a}=s.root;for(;a.length;)a[0].destroy();s.applySceneSettings(i.data.settings)};this._loadSceneHierarchy(e,r,t)}loadScene(e,t){let s=this._app,r=s.loader.getHandler("scene");s.assets&&s.assets.prefix&&!Bn.test(e)&&(e=oe.join(s.assets.prefix,e)),r.load(e,(i,a)=>{if(i)t&&t(i);else{let o=()=>{s.systems.script.preloading=!0;let n=r.open(e,a),c=this.findByUrl(e);c&&!c.loaded&&(c.data=a),s.systems.script.preloading=!1,s.loader.clearCache(e,"scene"),s.loader.patch({resource:n,type:"scene"},s.assets),s.root.addChild(n.root),s.systems.rigidbody&&s.systems.rigidbody.gravity.set(n._gravity.x,n._gravity.y,n._gravity.z),t&&t(null,n)};s._preloadScripts(a,o)}})}};var Jd=class{_app;_user=new Map;constructor(e){this._app=e;let t=e.graphicsDevice;this.frame={fps:0,ms:0,dt:0,updateStart:0,updateTime:0,renderStart:0,renderTime:0,physicsStart:0,physicsTime:0,scriptUpdateStart:0,scriptUpdate:0,scriptPostUpdateStart:0,scriptPostUpdate:0,animUpdateStart:0,animUpdate:0,cullTime:0,sortTime:0,skinTime:0,morphTime:0,instancingTime:0,gsplats:0,gsplatSort:0,gsplatBufferCopy:0,shaders:0,materials:0,cameras:0,shadowMapUpdates:0,shadowMapTime:0,depthMapTime:0,forwardTime:0,lightClustersTime:0,lightClusters:0,_timeToCountFrames:0,_fpsAccum:0},this.drawCalls={forward:0,depth:0,shadow:0,immediate:0,misc:0,total:0,skinned:0,instanced:0,removedByInstancing:0},this.misc={renderTargetCreationTime:0},this.particles={updatesPerFrame:0,_updatesPerFrame:0,frameTime:0,_frameTime:0},this.shaders=t._shaderStats,this.vram=t._vram,this.gpu=t.gpuProfiler?.passTimings??new Map,Object.defineProperty(this.vram,"totalUsed",{get:function(){return this.tex+this.vb+this.ib+this.ub+this.sb}}),Object.defineProperty(this.vram,"geom",{get:function(){return this.vb+this.ib}}),Object.defineProperty(this.vram,"buffers",{get:function(){return this.ub+this.sb}})}get user(){return this._user}get drawCallCount(){return this.drawCalls.total}get primitiveCount(){return this.frame.primitives}get frameTime(){return this.frame.ms}get fps(){return this.frame.fps}get cpuUpdateTime(){return this.frame.updateTime}get cpuRenderTime(){return this.frame.renderTime}get cpuSystemUpdateTime(){return this.frame.scriptUpdate}get cpuSystemPostUpdateTime(){return this.frame.scriptPostUpdate}get cpuAnimationTime(){return this.frame.animUpdate}get cpuPhysicsTime(){return this.frame.physicsTime}get gpuFrameTime(){return this._app.graphicsDevice.gpuProfiler?.frameTime}get vramTotalBytes(){let e=this.vram;return e.tex+e.vb+e.ib+e.ub+e.sb}get vramTextureBytes(){return this.vram.tex}get vramVertexBufferBytes(){return this.vram.vb}get vramIndexBufferBytes(){return this.vram.ib}get vramUniformBufferBytes(){return this.vram.ub}get vramStorageBufferBytes(){return this.vram.sb}get scene(){return this._app.scene._stats}get lightmapper(){return this._app.lightmapper?.stats}get batcher(){let e=this._app._batcher;return e?e._stats:null}updateBasic(e,t,s,r,i){let a=this.frame;a.dt=t,a.ms=s,e>a._timeToCountFrames?(a.fps=a._fpsAccum,a._fpsAccum=0,a._timeToCountFrames=e+1e3):a._fpsAccum++,this.drawCalls.total=i._drawCallsPerFrame,i._drawCallsPerFrame=0,a.gsplats=r._gsplatCount,a.gsplatBufferCopy=r._gsplatBufferCopy??0}updateDetailed(e,t){let s=this.frame;s.cameras=e._camerasRendered,s.materials=e._materialSwitches,s.shaders=t._shaderSwitchesPerFrame,s.shadowMapUpdates=e._shadowMapUpdates,s.shadowMapTime=e._shadowMapTime,s.depthMapTime=e._depthMapTime,s.forwardTime=e._forwardTime,s.cullTime=e._cullTime,s.sortTime=e._sortTime,s.skinTime=e._skinTime,s.morphTime=e._morphTime,s.lightClusters=e._lightClusters,s.lightClustersTime=e._lightClustersTime,e._camerasRendered=0,e._materialSwitches=0,e._shadowMapUpdates=0,t._shaderSwitchesPerFrame=0,e._cullTime=0,e._layerCompositionUpdateTime=0,e._lightClustersTime=0,e._sortTime=0,e._skinTime=0,e._morphTime=0,e._shadowMapTime=0,e._depthMapTime=0,e._forwardTime=0,s=this.drawCalls,s.forward=e._forwardDrawCalls,s.culled=e._numDrawCallsCulled,s.depth=0,s.shadow=e._shadowDrawCalls,s.skinned=e._skinDrawCalls,s.immediate=0,s.instanced=0,s.removedByInstancing=0,s.misc=s.total-(s.forward+s.shadow),e._depthDrawCalls=0,e._shadowDrawCalls=0,e._forwardDrawCalls=0,e._numDrawCallsCulled=0,e._skinDrawCalls=0,e._immediateRendered=0,e._instancedDrawCalls=0,this.misc.renderTargetCreationTime=t.renderTargetCreationTime,s=this.particles,s.updatesPerFrame=s._updatesPerFrame,s.frameTime=s._frameTime,s._updatesPerFrame=0,s._frameTime=0}frameEnd(){this.frame.gsplatSort=0}};var UT=`
uniform float alpha_ref;
void alphaTest(float a) {
	if (a < alpha_ref) discard;
}
`;var kT=`
#ifdef LIT_AMBIENT_SOURCE == AMBIENTSH
	uniform vec3 ambientSH[9];
#endif
#if LIT_AMBIENT_SOURCE == ENVALATLAS
	#include "envAtlasPS"
	#ifndef ENV_ATLAS
	#define ENV_ATLAS
		uniform sampler2D {LIT_ENV_ATLAS};
	#endif
#endif
void addAmbient(vec3 worldNormal) {
	#ifdef LIT_AMBIENT_SOURCE == AMBIENTSH
		vec3 n = cubeMapRotate(worldNormal);
		vec3 color =
			ambientSH[0] +
			ambientSH[1] * n.x +
			ambientSH[2] * n.y +
			ambientSH[3] * n.z +
			ambientSH[4] * n.x * n.z +
			ambientSH[5] * n.z * n.y +
			ambientSH[6] * n.y * n.x +
			ambientSH[7] * (3.0 * n.z * n.z - 1.0) +
			ambientSH[8] * (n.x * n.x - n.y * n.y);
		dDiffuseLight += processEnvironment(max(color, vec3(0.0)));
	#endif
	#if LIT_AMBIENT_SOURCE == ENVALATLAS
		vec3 dir = normalize(cubeMapRotate(worldNormal) * vec3(-1.0, 1.0, 1.0));
		vec2 uv = mapUv(toSphericalUv(dir), vec4(128.0, 256.0 + 128.0, 64.0, 32.0) / atlasSize);
		vec4 raw = texture2D({LIT_ENV_ATLAS}, uv);
		vec3 linear = {ambientDecode}(raw);
		dDiffuseLight += processEnvironment(linear);
	#endif
	#if LIT_AMBIENT_SOURCE == CONSTANT
		dDiffuseLight += light_globalAmbient;
	#endif
}
`;var GT=`
#ifdef LIT_GGX_SPECULAR
	uniform float material_anisotropyIntensity;
	uniform vec2 material_anisotropyRotation;
#endif
void getAnisotropy() {
	dAnisotropy = 0.0;
	dAnisotropyRotation = vec2(1.0, 0.0);
#ifdef LIT_GGX_SPECULAR
	dAnisotropy = material_anisotropyIntensity;
	dAnisotropyRotation = material_anisotropyRotation;
#endif
	#ifdef STD_ANISOTROPY_TEXTURE
	vec3 anisotropyTex = texture2DBias({STD_ANISOTROPY_TEXTURE_NAME}, {STD_ANISOTROPY_TEXTURE_UV}, {STD_TEXTURE_BIAS}).rgb;
	dAnisotropy *= anisotropyTex.b;
	vec2 anisotropyRotationFromTex = anisotropyTex.rg * 2.0 - vec2(1.0);
	mat2 rotationMatrix = mat2(dAnisotropyRotation.x, dAnisotropyRotation.y, -dAnisotropyRotation.y, dAnisotropyRotation.x);
	dAnisotropyRotation = rotationMatrix * anisotropyRotationFromTex;
	#endif
	
	dAnisotropy = clamp(dAnisotropy, 0.0, 1.0);
}
`;var VT=`
#if defined(STD_AO_TEXTURE) || defined(STD_AO_VERTEX)
	uniform float material_aoIntensity;
#endif
#ifdef STD_AODETAIL_TEXTURE
	#include "detailModesPS"
#endif
void getAO() {
	dAo = 1.0;
	#ifdef STD_AO_TEXTURE
		float aoBase = texture2DBias({STD_AO_TEXTURE_NAME}, {STD_AO_TEXTURE_UV}, {STD_TEXTURE_BIAS}).{STD_AO_TEXTURE_CHANNEL};
		#ifdef STD_AODETAIL_TEXTURE
			float aoDetail = texture2DBias({STD_AODETAIL_TEXTURE_NAME}, {STD_AODETAIL_TEXTURE_UV}, {STD_TEXTURE_BIAS}).{STD_AODETAIL_TEXTURE_CHANNEL};
			aoBase = detailMode_{STD_AODETAIL_DETAILMODE}(vec3(aoBase), vec3(aoDetail)).r;
		#endif
		dAo *= aoBase;
	#endif
	#ifdef STD_AO_VERTEX
		dAo *= saturate(vVertexColor.{STD_AO_VERTEX_CHANNEL});
	#endif
	#if defined(STD_AO_TEXTURE) || defined(STD_AO_VERTEX)
		dAo = mix(1.0, dAo, material_aoIntensity);
	#endif
}
`;var zT=`
void occludeDiffuse(float ao) {
	dDiffuseLight *= ao;
}
`;var HT=`
#if LIT_OCCLUDE_SPECULAR != NONE
	#ifdef LIT_OCCLUDE_SPECULAR_FLOAT
		uniform float material_occludeSpecularIntensity;
	#endif
#endif
void occludeSpecular(float gloss, float ao, vec3 worldNormal, vec3 viewDir) {
	#if LIT_OCCLUDE_SPECULAR == AO
		#ifdef LIT_OCCLUDE_SPECULAR_FLOAT
			float specOcc = mix(1.0, ao, material_occludeSpecularIntensity);
		#else
			float specOcc = ao;
		#endif
	#endif
	#if LIT_OCCLUDE_SPECULAR == GLOSSDEPENDENT
		float specPow = exp2(gloss * 11.0);
		float specOcc = saturate(pow(dot(worldNormal, viewDir) + ao, 0.01 * specPow) - 1.0 + ao);
		#ifdef LIT_OCCLUDE_SPECULAR_FLOAT
			specOcc = mix(1.0, specOcc, material_occludeSpecularIntensity);
		#endif
	#endif
	#if LIT_OCCLUDE_SPECULAR != NONE
		dSpecularLight *= specOcc;
		dReflection *= specOcc;
		#ifdef LIT_SHEEN
			sSpecularLight *= specOcc;
			sReflection *= specOcc;
		#endif
	#endif
}
`;var WT=`
	vec4 dirLm = texture2D(texture_dirLightMap, vUv1);
	if (bakeDir > 0.5) {
		if (dAtten > 0.00001) {
			dirLm.xyz = dirLm.xyz * 2.0 - vec3(1.0);
			dAtten = saturate(dAtten);
			gl_FragColor.rgb = normalize(dLightDirNormW.xyz*dAtten + dirLm.xyz*dirLm.w) * 0.5 + vec3(0.5);
			gl_FragColor.a = dirLm.w + dAtten;
			gl_FragColor.a = max(gl_FragColor.a, 1.0 / 255.0);
		} else {
			gl_FragColor = dirLm;
		}
	} else {
		gl_FragColor.rgb = dirLm.xyz;
		gl_FragColor.a = max(dirLm.w, dAtten > 0.00001 ? (1.0/255.0) : 0.0);
	}
`;var XT=`
#ifdef LIT_LIGHTMAP_BAKING_ADD_AMBIENT
	dDiffuseLight = ((dDiffuseLight - 0.5) * max(ambientBakeOcclusionContrast + 1.0, 0.0)) + 0.5;
	dDiffuseLight += vec3(ambientBakeOcclusionBrightness);
	dDiffuseLight = saturate(dDiffuseLight);
	dDiffuseLight *= dAmbientLight;
#endif
#ifdef LIGHTMAP_RGBM
	gl_FragColor.rgb = dDiffuseLight;
	gl_FragColor.rgb = pow(gl_FragColor.rgb, vec3(0.5));
	gl_FragColor.rgb /= 8.0;
	gl_FragColor.a = clamp( max( max( gl_FragColor.r, gl_FragColor.g ), max( gl_FragColor.b, 1.0 / 255.0 ) ), 0.0,1.0 );
	gl_FragColor.a = ceil(gl_FragColor.a * 255.0) / 255.0;
	gl_FragColor.rgb /= gl_FragColor.a;
#else
	gl_FragColor = vec4(dDiffuseLight, 1.0);
#endif
`;var YT=`
uniform vec3 view_position;
uniform vec3 light_globalAmbient;
float square(float x) {
	return x*x;
}
float saturate(float x) {
	return clamp(x, 0.0, 1.0);
}
vec3 saturate(vec3 x) {
	return clamp(x, vec3(0.0), vec3(1.0));
}
`;var jT=`
#define NINESLICED
varying vec2 vMask;
varying vec2 vTiledUv;
uniform mediump vec4 innerOffset;
uniform mediump vec2 outerScale;
uniform mediump vec4 atlasRect;
vec2 nineSlicedUv;
`;var qT=`
#define NINESLICED
#define NINESLICETILED
varying vec2 vMask;
varying vec2 vTiledUv;
uniform mediump vec4 innerOffset;
uniform mediump vec2 outerScale;
uniform mediump vec4 atlasRect;
vec2 nineSlicedUv;
`;var $T=`
float bayer2(vec2 p) {
	return mod(2.0 * p.y + p.x + 1.0, 4.0);
}
float bayer4(vec2 p) {
	vec2 p1 = mod(p, 2.0);
	vec2 p2 = floor(0.5 * mod(p, 4.0));
	return 4.0 * bayer2(p1) + bayer2(p2);
}
float bayer8(vec2 p) {
	vec2 p1 = mod(p, 2.0);
	vec2 p2 = floor(0.5 * mod(p, 4.0));
	vec2 p4 = floor(0.25 * mod(p, 8.0));
	return 4.0 * (4.0 * bayer2(p1) + bayer2(p2)) + bayer2(p4);
}
float bayer16(vec2 p) {
	vec2 p1 = mod(p, 2.0);
	vec2 p2 = floor(0.5 * mod(p, 4.0));
	vec2 p4 = floor(0.25 * mod(p, 8.0));
	vec2 p8 = floor(0.125 * mod(p, 16.0));
	return 4.0 * (4.0 * (4.0 * bayer2(p1) + bayer2(p2)) + bayer2(p4)) + bayer2(p8);
}
`;var KT=`
varying vec2 vUv0;
uniform sampler2D source;
uniform vec2 pixelOffset;
#ifdef GAUSS
	uniform float weight[{SAMPLES}];
#endif
void main(void) {
	vec3 moments = vec3(0.0);
	vec2 uv = vUv0 - pixelOffset * (float({SAMPLES}) * 0.5);
	for (int i = 0; i < {SAMPLES}; i++) {
		vec4 c = texture2D(source, uv + pixelOffset * float(i));
		#ifdef GAUSS
			moments += c.xyz * weight[i];
		#else
			moments += c.xyz;
		#endif
	}
	#ifndef GAUSS
		moments *= 1.0 / float({SAMPLES});
	#endif
	gl_FragColor = vec4(moments.x, moments.y, moments.z, 1.0);
}
`;var ZT=`
uniform float material_clearCoat;
void getClearCoat() {
	ccSpecularity = material_clearCoat;
	#ifdef STD_CLEARCOAT_TEXTURE
	ccSpecularity *= texture2DBias({STD_CLEARCOAT_TEXTURE_NAME}, {STD_CLEARCOAT_TEXTURE_UV}, {STD_TEXTURE_BIAS}).{STD_CLEARCOAT_TEXTURE_CHANNEL};
	#endif
	#ifdef STD_CLEARCOAT_VERTEX
	ccSpecularity *= saturate(vVertexColor.{STD_CLEARCOAT_VERTEX_CHANNEL});
	#endif
}
`;var QT=`
uniform float material_clearCoatGloss;
void getClearCoatGlossiness() {
	ccGlossiness = material_clearCoatGloss;
	#ifdef STD_CLEARCOATGLOSS_TEXTURE
	ccGlossiness *= texture2DBias({STD_CLEARCOATGLOSS_TEXTURE_NAME}, {STD_CLEARCOATGLOSS_TEXTURE_UV}, {STD_TEXTURE_BIAS}).{STD_CLEARCOATGLOSS_TEXTURE_CHANNEL};
	#endif
	#ifdef STD_CLEARCOATGLOSS_VERTEX
	ccGlossiness *= saturate(vVertexColor.{STD_CLEARCOATGLOSS_VERTEX_CHANNEL});
	#endif
	#ifdef STD_CLEARCOATGLOSS_INVERT
	ccGlossiness = 1.0 - ccGlossiness;
	#endif
	ccGlossiness += 0.0000001;
}
`;var JT=`
#ifdef STD_CLEARCOATNORMAL_TEXTURE
uniform float material_clearCoatBumpiness;
#endif
void getClearCoatNormal() {
#ifdef STD_CLEARCOATNORMAL_TEXTURE
	vec3 normalMap = {STD_CLEARCOATNORMAL_TEXTURE_DECODE}(texture2DBias({STD_CLEARCOATNORMAL_TEXTURE_NAME}, {STD_CLEARCOATNORMAL_TEXTURE_UV}, {STD_TEXTURE_BIAS}));
	normalMap = mix(vec3(0.0, 0.0, 1.0), normalMap, material_clearCoatBumpiness);
	ccNormalW = normalize(dTBN * normalMap);
#else
	ccNormalW = dVertexNormalW;
#endif
}
`;var eE=`
vec2 getCubemapFaceCoordinates(const vec3 dir, out float faceIndex, out vec2 tileOffset)
{
	vec3 vAbs = abs(dir);
	float ma;
	vec2 uv;
	if (vAbs.z >= vAbs.x && vAbs.z >= vAbs.y) {
		faceIndex = dir.z < 0.0 ? 5.0 : 4.0;
		ma = 0.5 / vAbs.z;
		uv = vec2(dir.z < 0.0 ? -dir.x : dir.x, -dir.y);
		tileOffset.x = 2.0;
		tileOffset.y = dir.z < 0.0 ? 1.0 : 0.0;
	} else if(vAbs.y >= vAbs.x) {
		faceIndex = dir.y < 0.0 ? 3.0 : 2.0;
		ma = 0.5 / vAbs.y;
		uv = vec2(dir.x, dir.y < 0.0 ? -dir.z : dir.z);
		tileOffset.x = 1.0;
		tileOffset.y = dir.y < 0.0 ? 1.0 : 0.0;
	} else {
		faceIndex = dir.x < 0.0 ? 1.0 : 0.0;
		ma = 0.5 / vAbs.x;
		uv = vec2(dir.x < 0.0 ? dir.z : -dir.z, -dir.y);
		tileOffset.x = 0.0;
		tileOffset.y = dir.x < 0.0 ? 1.0 : 0.0;
	}
	return uv * ma + 0.5;
}
vec2 getCubemapAtlasCoordinates(const vec3 omniAtlasViewport, float shadowEdgePixels, float shadowTextureResolution, const vec3 dir) {
	float faceIndex;
	vec2 tileOffset;
	vec2 uv = getCubemapFaceCoordinates(dir, faceIndex, tileOffset);
	float atlasFaceSize = omniAtlasViewport.z;
	float tileSize = shadowTextureResolution * atlasFaceSize;
	float offset = shadowEdgePixels / tileSize;
	uv = uv * vec2(1.0 - offset * 2.0) + vec2(offset * 1.0);
	uv *= atlasFaceSize;
	uv += tileOffset * atlasFaceSize;
	uv += omniAtlasViewport.xy;
	return uv;
}
`;var tE=`
vec3 _getCookieClustered(TEXTURE_ACCEPT(tex), vec2 uv, float intensity, vec4 cookieChannel) {
	vec4 pixel = mix(vec4(1.0), texture2DLod(tex, uv, 0.0), intensity);
	bool isRgb = dot(cookieChannel.rgb, vec3(1.0)) == 3.0;
	return isRgb ? pixel.rgb : vec3(dot(pixel, cookieChannel));
}
vec3 getCookie2DClustered(TEXTURE_ACCEPT(tex), mat4 transform, vec3 worldPosition, float intensity, vec4 cookieChannel) {
	vec4 projPos = transform * vec4(worldPosition, 1.0);
	return _getCookieClustered(TEXTURE_PASS(tex), projPos.xy / projPos.w, intensity, cookieChannel);
}
vec3 getCookieCubeClustered(TEXTURE_ACCEPT(tex), vec3 dir, float intensity, vec4 cookieChannel, float shadowTextureResolution, float shadowEdgePixels, vec3 omniAtlasViewport) {
	vec2 uv = getCubemapAtlasCoordinates(omniAtlasViewport, shadowEdgePixels, shadowTextureResolution, dir);
	return _getCookieClustered(TEXTURE_PASS(tex), uv, intensity, cookieChannel);
}
`;var sE=`
vec3 _getShadowCoordPerspZbuffer(mat4 shadowMatrix, vec4 shadowParams, vec3 wPos) {
	vec4 projPos = shadowMatrix * vec4(wPos, 1.0);
	projPos.xyz /= projPos.w;
	return projPos.xyz;
}
vec3 getShadowCoordPerspZbufferNormalOffset(mat4 shadowMatrix, vec4 shadowParams, vec3 normal) {
	vec3 wPos = vPositionW + normal * shadowParams.y;
	return _getShadowCoordPerspZbuffer(shadowMatrix, shadowParams, wPos);
}
vec3 normalOffsetPointShadow(vec4 shadowParams, vec3 lightPos, vec3 lightDir, vec3 lightDirNorm, vec3 normal) {
	float distScale = length(lightDir);
	vec3 wPos = vPositionW + normal * shadowParams.y * clamp(1.0 - dot(normal, -lightDirNorm), 0.0, 1.0) * distScale;
	vec3 dir = wPos - lightPos;
	return dir;
}
#if defined(CLUSTER_SHADOW_TYPE_PCF1)
float getShadowOmniClusteredPCF1(SHADOWMAP_ACCEPT(shadowMap), vec4 shadowParams, vec3 omniAtlasViewport, float shadowEdgePixels, vec3 lightDir) {
	float shadowTextureResolution = shadowParams.x;
	vec2 uv = getCubemapAtlasCoordinates(omniAtlasViewport, shadowEdgePixels, shadowTextureResolution, lightDir);
	float shadowZ = length(lightDir) * shadowParams.w + shadowParams.z;
	return textureShadow(shadowMap, vec3(uv, shadowZ));
}
#endif
#if defined(CLUSTER_SHADOW_TYPE_PCF3)
float getShadowOmniClusteredPCF3(SHADOWMAP_ACCEPT(shadowMap), vec4 shadowParams, vec3 omniAtlasViewport, float shadowEdgePixels, vec3 lightDir) {
	float shadowTextureResolution = shadowParams.x;
	vec2 uv = getCubemapAtlasCoordinates(omniAtlasViewport, shadowEdgePixels, shadowTextureResolution, lightDir);
	float shadowZ = length(lightDir) * shadowParams.w + shadowParams.z;
	vec3 shadowCoord = vec3(uv, shadowZ);
	return getShadowPCF3x3(SHADOWMAP_PASS(shadowMap), shadowCoord, shadowParams);
}
#endif
#if defined(CLUSTER_SHADOW_TYPE_PCF5)
float getShadowOmniClusteredPCF5(SHADOWMAP_ACCEPT(shadowMap), vec4 shadowParams, vec3 omniAtlasViewport, float shadowEdgePixels, vec3 lightDir) {
	float shadowTextureResolution = shadowParams.x;
	vec2 uv = getCubemapAtlasCoordinates(omniAtlasViewport, shadowEdgePixels, shadowTextureResolution, lightDir);
	float shadowZ = length(lightDir) * shadowParams.w + shadowParams.z;
	vec3 shadowCoord = vec3(uv, shadowZ);
	return getShadowPCF5x5(SHADOWMAP_PASS(shadowMap), shadowCoord, shadowParams);
}
#endif
#if defined(CLUSTER_SHADOW_TYPE_PCF1)
float getShadowSpotClusteredPCF1(SHADOWMAP_ACCEPT(shadowMap), vec3 shadowCoord, vec4 shadowParams) {
	return textureShadow(shadowMap, shadowCoord);
}
#endif
#if defined(CLUSTER_SHADOW_TYPE_PCF3)
float getShadowSpotClusteredPCF3(SHADOWMAP_ACCEPT(shadowMap), vec3 shadowCoord, vec4 shadowParams) {
	return getShadowSpotPCF3x3(SHADOWMAP_PASS(shadowMap), shadowCoord, shadowParams);
}
#endif
#if defined(CLUSTER_SHADOW_TYPE_PCF5)
float getShadowSpotClusteredPCF5(SHADOWMAP_ACCEPT(shadowMap), vec3 shadowCoord, vec4 shadowParams) {
	return getShadowPCF5x5(SHADOWMAP_PASS(shadowMap), shadowCoord, shadowParams);
}
#endif
`;var rE=`
#include "lightBufferDefinesPS"
#include "clusteredLightUtilsPS"
#ifdef CLUSTER_COOKIES
	#include "clusteredLightCookiesPS"
#endif
#ifdef CLUSTER_SHADOWS
	#include "clusteredLightShadowsPS"
#endif
uniform highp usampler2D clusterWorldTexture;
uniform highp sampler2D lightsTexture;
#ifdef CLUSTER_SHADOWS
	uniform sampler2DShadow shadowAtlasTexture;
#endif
#ifdef CLUSTER_COOKIES
	uniform sampler2D cookieAtlasTexture;
#endif
uniform int clusterMaxCells;
uniform int numClusteredLights;
uniform int clusterTextureWidth;
uniform vec3 clusterCellsCountByBoundsSize;
uniform vec3 clusterBoundsMin;
uniform vec3 clusterBoundsDelta;
uniform ivec3 clusterCellsDot;
uniform ivec3 clusterCellsMax;
uniform vec2 shadowAtlasParams;
struct ClusterLightData {
	vec3 position;
	int lightIndex;
	vec3 direction;
	uint shape;
	vec3 color;
	float shadowIntensity;
	float range;
	float biasesData;
	float cookieIntensity;
	bool isSpot;
	bool falloffModeLinear;
	bool isDynamic;
	bool isLightmapped;
};
struct ClusterLightSpotData {
	float innerConeAngleCos;
	float outerConeAngleCos;
};
struct ClusterLightAreaData {
	vec3 halfWidth;
	vec3 halfHeight;
};
struct ClusterLightShadowData {
	float shadowBias;
	float shadowNormalBias;
};
mat4 lightProjectionMatrix;
uint clusterLightData_flags;
float clusterLightData_anglesData;
uint clusterLightData_colorBFlagsData;
vec4 sampleLightTextureF(int lightIndex, int index) {
	return texelFetch(lightsTexture, ivec2(index, lightIndex), 0);
}
ClusterLightData decodeClusterLightCore(int lightIndex) {
	ClusterLightData clusterLightData;
	clusterLightData.lightIndex = lightIndex;
	vec4 halfData = sampleLightTextureF(lightIndex, {CLUSTER_TEXTURE_COLOR_ANGLES_BIAS});
	clusterLightData_anglesData = halfData.z;
	clusterLightData.biasesData = halfData.w;
	clusterLightData_colorBFlagsData = floatBitsToUint(halfData.y);
	vec2 colorRG = unpackHalf2x16(floatBitsToUint(halfData.x));
	vec2 colorB_flags = unpackHalf2x16(clusterLightData_colorBFlagsData);
	clusterLightData.color = vec3(colorRG, colorB_flags.x) * {LIGHT_COLOR_DIVIDER};
	vec4 lightPosRange = sampleLightTextureF(lightIndex, {CLUSTER_TEXTURE_POSITION_RANGE});
	clusterLightData.position = lightPosRange.xyz;
	clusterLightData.range = lightPosRange.w;
	vec4 lightDir_Flags = sampleLightTextureF(lightIndex, {CLUSTER_TEXTURE_DIRECTION_FLAGS});
	clusterLightData.direction = lightDir_Flags.xyz;
	clusterLightData_flags = floatBitsToUint(lightDir_Flags.w);
	clusterLightData.isSpot = (clusterLightData_flags & (1u << 30u)) != 0u;
	clusterLightData.shape = (clusterLightData_flags >> 28u) & 0x3u;
	clusterLightData.falloffModeLinear = (clusterLightData_flags & (1u << 27u)) == 0u;
	clusterLightData.shadowIntensity = float((clusterLightData_flags >> 0u) & 0xFFu) / 255.0;
	clusterLightData.cookieIntensity = float((clusterLightData_flags >> 8u) & 0xFFu) / 255.0;
	clusterLightData.isDynamic = (clusterLightData_flags & (1u << 22u)) != 0u;
	clusterLightData.isLightmapped = (clusterLightData_flags & (1u << 21u)) != 0u;
	return clusterLightData;
}
ClusterLightSpotData decodeClusterLightSpot() {
	uint angleFlags = (clusterLightData_colorBFlagsData >> 16u) & 0xFFFFu;
	vec2 angleValues = unpackHalf2x16(floatBitsToUint(clusterLightData_anglesData));
	float innerVal = angleValues.x;
	float outerVal = angleValues.y;
	float innerIsVersine = float(angleFlags & 1u);
	float outerIsVersine = float((angleFlags >> 1u) & 1u);
	return ClusterLightSpotData(
		mix(innerVal, 1.0 - innerVal, innerIsVersine),
		mix(outerVal, 1.0 - outerVal, outerIsVersine)
	);
}
vec3 decodeClusterLightOmniAtlasViewport(int lightIndex) {
	return sampleLightTextureF(lightIndex, {CLUSTER_TEXTURE_PROJ_MAT_0}).xyz;
}
ClusterLightAreaData decodeClusterLightAreaData(int lightIndex) {
	return ClusterLightAreaData(
		sampleLightTextureF(lightIndex, {CLUSTER_TEXTURE_AREA_DATA_WIDTH}).xyz,
		sampleLightTextureF(lightIndex, {CLUSTER_TEXTURE_AREA_DATA_HEIGHT}).xyz
	);
}
mat4 decodeClusterLightProjectionMatrixData(int lightIndex) {
	vec4 m0 = sampleLightTextureF(lightIndex, {CLUSTER_TEXTURE_PROJ_MAT_0});
	vec4 m1 = sampleLightTextureF(lightIndex, {CLUSTER_TEXTURE_PROJ_MAT_1});
	vec4 m2 = sampleLightTextureF(lightIndex, {CLUSTER_TEXTURE_PROJ_MAT_2});
	vec4 m3 = sampleLightTextureF(lightIndex, {CLUSTER_TEXTURE_PROJ_MAT_3});
	return mat4(m0, m1, m2, m3);
}
ClusterLightShadowData decodeClusterLightShadowData(float biasesData) {
	vec2 biases = unpackHalf2x16(floatBitsToUint(biasesData));
	return ClusterLightShadowData(biases.x, biases.y);
}
vec4 decodeClusterLightCookieData() {
	uint cookieFlags = (clusterLightData_flags >> 23u) & 0x0Fu;
	vec4 mask = vec4(uvec4(cookieFlags) & uvec4(1u, 2u, 4u, 8u));
	return step(1.0, mask);
}
void evaluateLight(
	ClusterLightData light, 
	vec3 worldNormal, 
	vec3 viewDir, 
	vec3 reflectionDir,
#if defined(LIT_CLEARCOAT)
	vec3 clearcoatReflectionDir,
#endif
	float gloss, 
	vec3 specularity, 
	vec3 geometricNormal, 
	mat3 tbn, 
#if defined(LIT_IRIDESCENCE)
	vec3 iridescenceFresnel,
#endif
	vec3 clearcoat_worldNormal,
	float clearcoat_gloss,
	float sheen_gloss,
	float iridescence_intensity
) {
	vec3 cookieAttenuation = vec3(1.0);
	float diffuseAttenuation = 1.0;
	float falloffAttenuation = 1.0;
	vec3 lightDirW = evalOmniLight(light.position);
	vec3 lightDirNormW = normalize(lightDirW);
	#ifdef CLUSTER_AREALIGHTS
	if (light.shape != {LIGHTSHAPE_PUNCTUAL}) {
		ClusterLightAreaData areaData = decodeClusterLightAreaData(light.lightIndex);
		if (light.shape == {LIGHTSHAPE_RECT}) {
			calcRectLightValues(light.position, areaData.halfWidth, areaData.halfHeight);
		} else if (light.shape == {LIGHTSHAPE_DISK}) {
			calcDiskLightValues(light.position, areaData.halfWidth, areaData.halfHeight);
		} else {
			calcSphereLightValues(light.position, areaData.halfWidth, areaData.halfHeight);
		}
		falloffAttenuation = getFalloffWindow(light.range, lightDirW);
	} else
	#endif
	{
		if (light.falloffModeLinear)
			falloffAttenuation = getFalloffLinear(light.range, lightDirW);
		else
			falloffAttenuation = getFalloffInvSquared(light.range, lightDirW);
	}
	if (falloffAttenuation > 0.00001) {
		#ifdef CLUSTER_AREALIGHTS
		if (light.shape != {LIGHTSHAPE_PUNCTUAL}) {
			if (light.shape == {LIGHTSHAPE_RECT}) {
				diffuseAttenuation = getRectLightDiffuse(worldNormal, viewDir, lightDirW, lightDirNormW) * 16.0;
			} else if (light.shape == {LIGHTSHAPE_DISK}) {
				diffuseAttenuation = getDiskLightDiffuse(worldNormal, viewDir, lightDirW, lightDirNormW) * 16.0;
			} else {
				diffuseAttenuation = getSphereLightDiffuse(worldNormal, viewDir, lightDirW, lightDirNormW) * 16.0;
			}
		} else
		#endif
		{
			falloffAttenuation *= getLightDiffuse(worldNormal, viewDir, lightDirNormW); 
		}
		if (light.isSpot) {
			ClusterLightSpotData spotData = decodeClusterLightSpot();
			falloffAttenuation *= getSpotEffect(light.direction, spotData.innerConeAngleCos, spotData.outerConeAngleCos, lightDirNormW);
		}
		#if defined(CLUSTER_COOKIES) || defined(CLUSTER_SHADOWS)
		if (falloffAttenuation > 0.00001) {
			if (light.shadowIntensity > 0.0 || light.cookieIntensity > 0.0) {
				vec3 omniAtlasViewport = vec3(0.0);
				if (light.isSpot) {
					lightProjectionMatrix = decodeClusterLightProjectionMatrixData(light.lightIndex);
				} else {
					omniAtlasViewport = decodeClusterLightOmniAtlasViewport(light.lightIndex);
				}
				float shadowTextureResolution = shadowAtlasParams.x;
				float shadowEdgePixels = shadowAtlasParams.y;
				#ifdef CLUSTER_COOKIES
				if (light.cookieIntensity > 0.0) {
					vec4 cookieChannelMask = decodeClusterLightCookieData();
					if (light.isSpot) {
						cookieAttenuation = getCookie2DClustered(TEXTURE_PASS(cookieAtlasTexture), lightProjectionMatrix, vPositionW, light.cookieIntensity, cookieChannelMask);
					} else {
						cookieAttenuation = getCookieCubeClustered(TEXTURE_PASS(cookieAtlasTexture), lightDirW, light.cookieIntensity, cookieChannelMask, shadowTextureResolution, shadowEdgePixels, omniAtlasViewport);
					}
				}
				#endif
				#ifdef CLUSTER_SHADOWS
				if (light.shadowIntensity > 0.0) {
					ClusterLightShadowData shadowData = decodeClusterLightShadowData(light.biasesData);
					vec4 shadowParams = vec4(shadowTextureResolution, shadowData.shadowNormalBias, shadowData.shadowBias, 1.0 / light.range);
					if (light.isSpot) {
						vec3 shadowCoord = getShadowCoordPerspZbufferNormalOffset(lightProjectionMatrix, shadowParams, geometricNormal);
						
						#if defined(CLUSTER_SHADOW_TYPE_PCF1)
							float shadow = getShadowSpotClusteredPCF1(SHADOWMAP_PASS(shadowAtlasTexture), shadowCoord, shadowParams);
						#elif defined(CLUSTER_SHADOW_TYPE_PCF3)
							float shadow = getShadowSpotClusteredPCF3(SHADOWMAP_PASS(shadowAtlasTexture), shadowCoord, shadowParams);
						#elif defined(CLUSTER_SHADOW_TYPE_PCF5)
							float shadow = getShadowSpotClusteredPCF5(SHADOWMAP_PASS(shadowAtlasTexture), shadowCoord, shadowParams);
						#elif defined(CLUSTER_SHADOW_TYPE_PCSS)
							float shadow = getShadowSpotClusteredPCSS(SHADOWMAP_PASS(shadowAtlasTexture), shadowCoord, shadowParams);
						#endif
						falloffAttenuation *= mix(1.0, shadow, light.shadowIntensity);
					} else {
						vec3 dir = normalOffsetPointShadow(shadowParams, light.position, lightDirW, lightDirNormW, geometricNormal);
						#if defined(CLUSTER_SHADOW_TYPE_PCF1)
							float shadow = getShadowOmniClusteredPCF1(SHADOWMAP_PASS(shadowAtlasTexture), shadowParams, omniAtlasViewport, shadowEdgePixels, dir);
						#elif defined(CLUSTER_SHADOW_TYPE_PCF3)
							float shadow = getShadowOmniClusteredPCF3(SHADOWMAP_PASS(shadowAtlasTexture), shadowParams, omniAtlasViewport, shadowEdgePixels, dir);
						#elif defined(CLUSTER_SHADOW_TYPE_PCF5)
							float shadow = getShadowOmniClusteredPCF5(SHADOWMAP_PASS(shadowAtlasTexture), shadowParams, omniAtlasViewport, shadowEdgePixels, dir);
						#endif
						falloffAttenuation *= mix(1.0, shadow, light.shadowIntensity);
					}
				}
				#endif
			}
		}
		#endif
		#ifdef CLUSTER_AREALIGHTS
		if (light.shape != {LIGHTSHAPE_PUNCTUAL}) {
			{
				vec3 areaDiffuse = (diffuseAttenuation * falloffAttenuation) * light.color * cookieAttenuation;
				#if defined(LIT_SPECULAR)
					areaDiffuse = mix(areaDiffuse, vec3(0), dLTCSpecFres);
				#endif
				dDiffuseLight += areaDiffuse;
			}
			#ifdef LIT_SPECULAR
				float areaLightSpecular;
				if (light.shape == {LIGHTSHAPE_RECT}) {
					areaLightSpecular = getRectLightSpecular(worldNormal, viewDir);
				} else if (light.shape == {LIGHTSHAPE_DISK}) {
					areaLightSpecular = getDiskLightSpecular(worldNormal, viewDir);
				} else {
					areaLightSpecular = getSphereLightSpecular(worldNormal, viewDir);
				}
				dSpecularLight += dLTCSpecFres * areaLightSpecular * falloffAttenuation * light.color * cookieAttenuation;
				#ifdef LIT_CLEARCOAT
					float areaLightSpecularCC;
					if (light.shape == {LIGHTSHAPE_RECT}) {
						areaLightSpecularCC = getRectLightSpecular(clearcoat_worldNormal, viewDir);
					} else if (light.shape == {LIGHTSHAPE_DISK}) {
						areaLightSpecularCC = getDiskLightSpecular(clearcoat_worldNormal, viewDir);
					} else {
						areaLightSpecularCC = getSphereLightSpecular(clearcoat_worldNormal, viewDir);
					}
					ccSpecularLight += ccLTCSpecFres * areaLightSpecularCC * falloffAttenuation * light.color  * cookieAttenuation;
				#endif
			#endif
		} else
		#endif
		{
			{
				vec3 punctualDiffuse = falloffAttenuation * light.color * cookieAttenuation;
				#if defined(CLUSTER_AREALIGHTS)
				#if defined(LIT_SPECULAR)
					punctualDiffuse = mix(punctualDiffuse, vec3(0), specularity);
				#endif
				#endif
				dDiffuseLight += punctualDiffuse;
			}
	 
			#ifdef LIT_SPECULAR
				vec3 halfDir = normalize(-lightDirNormW + viewDir);
				
				#ifdef LIT_SPECULAR_FRESNEL
					dSpecularLight += 
						getLightSpecular(halfDir, reflectionDir, worldNormal, viewDir, lightDirNormW, gloss, tbn) * falloffAttenuation * light.color * cookieAttenuation * 
						getFresnel(
							dot(viewDir, halfDir), 
							gloss, 
							specularity
						#if defined(LIT_IRIDESCENCE)
							, iridescenceFresnel,
							iridescence_intensity
						#endif
							);
				#else
					dSpecularLight += getLightSpecular(halfDir, reflectionDir, worldNormal, viewDir, lightDirNormW, gloss, tbn) * falloffAttenuation * light.color * cookieAttenuation * specularity;
				#endif
				#ifdef LIT_CLEARCOAT
					#ifdef LIT_SPECULAR_FRESNEL
						ccSpecularLight += getLightSpecular(halfDir, clearcoatReflectionDir, clearcoat_worldNormal, viewDir, lightDirNormW, clearcoat_gloss, tbn) * falloffAttenuation * light.color * cookieAttenuation * getFresnelCC(dot(viewDir, halfDir));
					#else
						ccSpecularLight += getLightSpecular(halfDir, clearcoatReflectionDir, clearcoat_worldNormal, viewDir, lightDirNormW, clearcoat_gloss, tbn) * falloffAttenuation * light.color * cookieAttenuation; 
					#endif
				#endif
				#ifdef LIT_SHEEN
					sSpecularLight += getLightSpecularSheen(halfDir, worldNormal, viewDir, lightDirNormW, sheen_gloss) * falloffAttenuation * light.color * cookieAttenuation;
				#endif
			#endif
		}
	}
	dAtten = falloffAttenuation;
	dLightDirNormW = lightDirNormW;
}
void evaluateClusterLight(
	int lightIndex, 
	vec3 worldNormal, 
	vec3 viewDir, 
	vec3 reflectionDir, 
#if defined(LIT_CLEARCOAT)
	vec3 clearcoatReflectionDir,
#endif
	float gloss, 
	vec3 specularity, 
	vec3 geometricNormal, 
	mat3 tbn, 
#if defined(LIT_IRIDESCENCE)
	vec3 iridescenceFresnel,
#endif
	vec3 clearcoat_worldNormal,
	float clearcoat_gloss,
	float sheen_gloss,
	float iridescence_intensity
) {
	ClusterLightData clusterLightData = decodeClusterLightCore(lightIndex);
	#ifdef CLUSTER_MESH_DYNAMIC_LIGHTS
		bool acceptLightMask = clusterLightData.isDynamic;
	#else
		bool acceptLightMask = clusterLightData.isLightmapped;
	#endif
	if (acceptLightMask)
		evaluateLight(
			clusterLightData, 
			worldNormal, 
			viewDir, 
			reflectionDir, 
#if defined(LIT_CLEARCOAT)
			clearcoatReflectionDir, 
#endif
			gloss, 
			specularity, 
			geometricNormal, 
			tbn, 
#if defined(LIT_IRIDESCENCE)
			iridescenceFresnel,
#endif
			clearcoat_worldNormal,
			clearcoat_gloss,
			sheen_gloss,
			iridescence_intensity
		);
}
void addClusteredLights(
	vec3 worldNormal, 
	vec3 viewDir, 
	vec3 reflectionDir, 
#if defined(LIT_CLEARCOAT)
	vec3 clearcoatReflectionDir,
#endif
	float gloss, 
	vec3 specularity, 
	vec3 geometricNormal, 
	mat3 tbn, 
#if defined(LIT_IRIDESCENCE)
	vec3 iridescenceFresnel,
#endif
	vec3 clearcoat_worldNormal,
	float clearcoat_gloss,
	float sheen_gloss,
	float iridescence_intensity
) {
	if (numClusteredLights <= 1)
		return;
	ivec3 cellCoords = ivec3(floor((vPositionW - clusterBoundsMin) * clusterCellsCountByBoundsSize));
	if (!(any(lessThan(cellCoords, ivec3(0))) || any(greaterThanEqual(cellCoords, clusterCellsMax)))) {
		int cellIndex = cellCoords.x * clusterCellsDot.x + cellCoords.y * clusterCellsDot.y + cellCoords.z * clusterCellsDot.z;
		int clusterV = cellIndex / clusterTextureWidth;
		int clusterU = cellIndex - clusterV * clusterTextureWidth;
		for (int lightCellIndex = 0; lightCellIndex < clusterMaxCells; lightCellIndex++) {
			uint lightIndex = texelFetch(clusterWorldTexture, ivec2(clusterU + lightCellIndex, clusterV), 0).x;
			if (lightIndex == 0u)
				break;
			evaluateClusterLight(
				int(lightIndex), 
				worldNormal, 
				viewDir, 
				reflectionDir,
#if defined(LIT_CLEARCOAT)
				clearcoatReflectionDir,
#endif
				gloss, 
				specularity, 
				geometricNormal, 
				tbn, 
#if defined(LIT_IRIDESCENCE)
				iridescenceFresnel,
#endif
				clearcoat_worldNormal,
				clearcoat_gloss,
				sheen_gloss,
				iridescence_intensity
			); 
		}
	}
}
`;var iE=`
vec3 combineColor(vec3 albedo, vec3 sheenSpecularity, float clearcoatSpecularity) {
	vec3 ret = vec3(0);
#ifdef LIT_OLD_AMBIENT
	ret += (dDiffuseLight - light_globalAmbient) * albedo + litArgs_ambient * light_globalAmbient;
#else
	ret += albedo * dDiffuseLight;
#endif
#ifdef LIT_SPECULAR
	ret += dSpecularLight;
#endif
#ifdef LIT_REFLECTIONS
	ret += dReflection.rgb * dReflection.a;
#endif
#ifdef LIT_SHEEN
	float sheenScaling = 1.0 - max(max(sheenSpecularity.r, sheenSpecularity.g), sheenSpecularity.b) * 0.157;
	ret = ret * sheenScaling + (sSpecularLight + sReflection.rgb) * sheenSpecularity;
#endif
#ifdef LIT_CLEARCOAT
	float clearCoatScaling = 1.0 - ccFresnel * clearcoatSpecularity;
	ret = ret * clearCoatScaling + (ccSpecularLight + ccReflection) * clearcoatSpecularity;
#endif
	return ret;
}
`;var aE=`
	varying vec2 uv0;
	uniform sampler2D blitTexture;
	void main(void) {
		gl_FragColor = texture2D(blitTexture, uv0);
	}
`;var oE=`
	varying vec2 uv0;
	uniform samplerCube blitTexture;
	uniform mat4 invViewProj;
	void main(void) {
		vec4 projPos = vec4(uv0 * 2.0 - 1.0, 0.5, 1.0);
		vec4 worldPos = invViewProj * projPos;
		gl_FragColor = textureCube(blitTexture, worldPos.xyz);
	}
`;var nE=`
	attribute vec2 vertex_position;
	varying vec2 uv0;
	void main(void) {
		gl_Position = vec4(vertex_position, 0.5, 1.0);
		uv0 = vertex_position.xy * 0.5 + 0.5;
		#ifndef WEBGPU
			uv0.y = 1.0 - uv0.y;
		#endif
	}
`;var lE=`
vec4 getCookie2D(sampler2D tex, mat4 transform, float intensity) {
	vec4 projPos = transform * vec4(vPositionW, 1.0);
	projPos.xy /= projPos.w;
	return mix(vec4(1.0), texture2D(tex, projPos.xy), intensity);
}
vec4 getCookie2DClip(sampler2D tex, mat4 transform, float intensity) {
	vec4 projPos = transform * vec4(vPositionW, 1.0);
	projPos.xy /= projPos.w;
	if (projPos.x < 0.0 || projPos.x > 1.0 || projPos.y < 0.0 || projPos.y > 1.0 || projPos.z < 0.0) return vec4(0.0);
	return mix(vec4(1.0), texture2D(tex, projPos.xy), intensity);
}
vec4 getCookie2DXform(sampler2D tex, mat4 transform, float intensity, vec4 cookieMatrix, vec2 cookieOffset) {
	vec4 projPos = transform * vec4(vPositionW, 1.0);
	projPos.xy /= projPos.w;
	projPos.xy += cookieOffset;
	vec2 uv = mat2(cookieMatrix) * (projPos.xy-vec2(0.5)) + vec2(0.5);
	return mix(vec4(1.0), texture2D(tex, uv), intensity);
}
vec4 getCookie2DClipXform(sampler2D tex, mat4 transform, float intensity, vec4 cookieMatrix, vec2 cookieOffset) {
	vec4 projPos = transform * vec4(vPositionW, 1.0);
	projPos.xy /= projPos.w;
	projPos.xy += cookieOffset;
	if (projPos.x < 0.0 || projPos.x > 1.0 || projPos.y < 0.0 || projPos.y > 1.0 || projPos.z < 0.0) return vec4(0.0);
	vec2 uv = mat2(cookieMatrix) * (projPos.xy-vec2(0.5)) + vec2(0.5);
	return mix(vec4(1.0), texture2D(tex, uv), intensity);
}
vec4 getCookieCube(samplerCube tex, mat4 transform, float intensity) {
	return mix(vec4(1.0), textureCube(tex, dLightDirNormW * mat3(transform)), intensity);
}
`;var cE=`
#if LIT_CUBEMAP_PROJECTION == BOX
	uniform vec3 envBoxMin;
	uniform vec3 envBoxMax;
#endif
vec3 cubeMapProject(vec3 nrdir) {
	#if LIT_CUBEMAP_PROJECTION == NONE
		return cubeMapRotate(nrdir);
	#endif
	#if LIT_CUBEMAP_PROJECTION == BOX
		nrdir = cubeMapRotate(nrdir);
		vec3 rbmax = (envBoxMax - vPositionW) / nrdir;
		vec3 rbmin = (envBoxMin - vPositionW) / nrdir;
		vec3 rbminmax = mix(rbmin, rbmax, vec3(greaterThan(nrdir, vec3(0.0))));
		float fa = min(min(rbminmax.x, rbminmax.y), rbminmax.z);
		vec3 posonbox = vPositionW + nrdir * fa;
		vec3 envBoxPos = (envBoxMin + envBoxMax) * 0.5;
		return normalize(posonbox - envBoxPos);
	#endif
}
`;var hE=`
#ifdef CUBEMAP_ROTATION
uniform mat3 cubeMapRotationMatrix;
#endif
vec3 cubeMapRotate(vec3 refDir) {
#ifdef CUBEMAP_ROTATION
	return refDir * cubeMapRotationMatrix;
#else
	return refDir;
#endif
}
`;var dE=`
#ifdef DEBUG_ALBEDO_PASS
gl_FragColor = vec4(gammaCorrectOutput(dAlbedo), 1.0);
#endif
#ifdef DEBUG_UV0_PASS
gl_FragColor = vec4(litArgs_albedo , 1.0);
#endif
#ifdef DEBUG_WORLD_NORMAL_PASS
gl_FragColor = vec4(litArgs_worldNormal * 0.5 + 0.5, 1.0);
#endif
#ifdef DEBUG_OPACITY_PASS
gl_FragColor = vec4(vec3(litArgs_opacity) , 1.0);
#endif
#ifdef DEBUG_SPECULARITY_PASS
gl_FragColor = vec4(litArgs_specularity, 1.0);
#endif
#ifdef DEBUG_GLOSS_PASS
gl_FragColor = vec4(vec3(litArgs_gloss) , 1.0);
#endif
#ifdef DEBUG_METALNESS_PASS
gl_FragColor = vec4(vec3(litArgs_metalness) , 1.0);
#endif
#ifdef DEBUG_AO_PASS
gl_FragColor = vec4(vec3(litArgs_ao) , 1.0);
#endif
#ifdef DEBUG_EMISSION_PASS
gl_FragColor = vec4(gammaCorrectOutput(litArgs_emission), 1.0);
#endif
`;var fE=`
#ifdef DEBUG_LIGHTING_PASS
litArgs_albedo = vec3(0.5);
#endif
#ifdef DEBUG_UV0_PASS
#ifdef VARYING_VUV0
litArgs_albedo = vec3(vUv0, 0);
#else
litArgs_albedo = vec3(0);
#endif
#endif
`;var uE=`
#ifndef _DECODE_INCLUDED_
#define _DECODE_INCLUDED_
vec3 decodeLinear(vec4 raw) {
	return raw.rgb;
}
float decodeGamma(float raw) {
	return pow(raw, 2.2);
}
vec3 decodeGamma(vec3 raw) {
	return pow(raw, vec3(2.2));
}
vec3 decodeGamma(vec4 raw) {
	return pow(raw.xyz, vec3(2.2));
}
vec3 decodeRGBM(vec4 raw) {
	vec3 color = (8.0 * raw.a) * raw.rgb;
	return color * color;
}
vec3 decodeRGBP(vec4 raw) {
	vec3 color = raw.rgb * (-raw.a * 7.0 + 8.0);
	return color * color;
}
vec3 decodeRGBE(vec4 raw) {
	if (raw.a == 0.0) {
		return vec3(0.0, 0.0, 0.0);
	} else {
		return raw.xyz * pow(2.0, raw.w * 255.0 - 128.0);
	}
}
vec4 passThrough(vec4 raw) {
	return raw;
}
vec3 unpackNormalXYZ(vec4 nmap) {
	return nmap.xyz * 2.0 - 1.0;
}
vec3 unpackNormalXY(vec4 nmap) {
	vec3 normal;
	normal.xy = nmap.wy * 2.0 - 1.0;
	normal.z = sqrt(1.0 - clamp(dot(normal.xy, normal.xy), 0.0, 1.0));
	return normal;
}
#endif
`;var mE=`
#ifndef _DETAILMODES_INCLUDED_
#define _DETAILMODES_INCLUDED_
vec3 detailMode_mul(vec3 c1, vec3 c2) {
	return c1 * c2;
}
vec3 detailMode_add(vec3 c1, vec3 c2) {
	return c1 + c2;
}
vec3 detailMode_screen(vec3 c1, vec3 c2) {
	return 1.0 - (1.0 - c1)*(1.0 - c2);
}
vec3 detailMode_overlay(vec3 c1, vec3 c2) {
	return mix(1.0 - 2.0 * (1.0 - c1)*(1.0 - c2), 2.0 * c1 * c2, step(c1, vec3(0.5)));
}
vec3 detailMode_min(vec3 c1, vec3 c2) {
	return min(c1, c2);
}
vec3 detailMode_max(vec3 c1, vec3 c2) {
	return max(c1, c2);
}
#endif
`;var pE=`
uniform vec3 material_diffuse;
#ifdef STD_DIFFUSEDETAIL_TEXTURE
	#include "detailModesPS"
#endif
void getAlbedo() {
	dAlbedo = material_diffuse.rgb;
	#ifdef STD_DIFFUSE_TEXTURE
		vec3 albedoTexture = {STD_DIFFUSE_TEXTURE_DECODE}(texture2DBias({STD_DIFFUSE_TEXTURE_NAME}, {STD_DIFFUSE_TEXTURE_UV}, {STD_TEXTURE_BIAS})).{STD_DIFFUSE_TEXTURE_CHANNEL};
		#ifdef STD_DIFFUSEDETAIL_TEXTURE
			vec3 albedoDetail = {STD_DIFFUSEDETAIL_TEXTURE_DECODE}(texture2DBias({STD_DIFFUSEDETAIL_TEXTURE_NAME}, {STD_DIFFUSEDETAIL_TEXTURE_UV}, {STD_TEXTURE_BIAS})).{STD_DIFFUSEDETAIL_TEXTURE_CHANNEL};
			albedoTexture = detailMode_{STD_DIFFUSEDETAIL_DETAILMODE}(albedoTexture, albedoDetail);
		#endif
		dAlbedo *= albedoTexture;
	#endif
	#ifdef STD_DIFFUSE_VERTEX
		dAlbedo *= saturate(vVertexColor.{STD_DIFFUSE_VERTEX_CHANNEL});
	#endif
}
`;var _E=`
#ifndef MESH_COLOR
	uniform vec3 material_emissive;
#endif
uniform float material_emissiveIntensity;
void getEmission() {
	#ifdef MESH_COLOR
		dEmission = mesh_color.rgb * material_emissiveIntensity;
	#else
		dEmission = material_emissive * material_emissiveIntensity;
	#endif
	#ifdef STD_EMISSIVE_TEXTURE
	dEmission *= {STD_EMISSIVE_TEXTURE_DECODE}(texture2DBias({STD_EMISSIVE_TEXTURE_NAME}, {STD_EMISSIVE_TEXTURE_UV}, {STD_TEXTURE_BIAS})).{STD_EMISSIVE_TEXTURE_CHANNEL};
	#endif
	#ifdef STD_EMISSIVE_VERTEX
	dEmission *= saturate(vVertexColor.{STD_EMISSIVE_VERTEX_CHANNEL});
	#endif
}
`;var gE=`
vec4 encodeLinear(vec3 source) {
	return vec4(source, 1.0);
}
vec4 encodeGamma(vec3 source) {
	return vec4(pow(source + 0.0000001, vec3(1.0 / 2.2)), 1.0);
}
vec4 encodeRGBM(vec3 source) {
	vec4 result;
	result.rgb = pow(source.rgb, vec3(0.5));
	result.rgb *= 1.0 / 8.0;
	result.a = saturate( max( max( result.r, result.g ), max( result.b, 1.0 / 255.0 ) ) );
	result.a = ceil(result.a * 255.0) / 255.0;
	result.rgb /= result.a;
	return result;
}
vec4 encodeRGBP(vec3 source) {
	vec3 gamma = pow(source, vec3(0.5));
	float maxVal = min(8.0, max(1.0, max(gamma.x, max(gamma.y, gamma.z))));
	float v = 1.0 - ((maxVal - 1.0) / 7.0);
	v = ceil(v * 255.0) / 255.0;
	return vec4(gamma / (-v * 7.0 + 8.0), v);	
}
vec4 encodeRGBE(vec3 source) {
	float maxVal = max(source.x, max(source.y, source.z));
	if (maxVal < 1e-32) {
		return vec4(0, 0, 0, 0);
	} else {
		float e = ceil(log2(maxVal));
		return vec4(source / pow(2.0, e), (e + 128.0) / 255.0);
	}
}
`;var SE=`
	gl_FragColor.rgb = combineColor(litArgs_albedo, litArgs_sheen_specularity, litArgs_clearcoat_specularity);
	gl_FragColor.rgb += litArgs_emission;
	gl_FragColor.rgb = addFog(gl_FragColor.rgb);
	gl_FragColor.rgb = toneMap(gl_FragColor.rgb);
	gl_FragColor.rgb = gammaCorrectOutput(gl_FragColor.rgb);
`;var TE=`
#ifndef _ENVATLAS_INCLUDED_
#define _ENVATLAS_INCLUDED_
const float atlasSize = 512.0;
const float seamSize = 1.0 / atlasSize;
vec2 mapUv(vec2 uv, vec4 rect) {
	return vec2(mix(rect.x + seamSize, rect.x + rect.z - seamSize, uv.x),
				mix(rect.y + seamSize, rect.y + rect.w - seamSize, uv.y));
}
vec2 mapRoughnessUv(vec2 uv, float level) {
	float t = 1.0 / exp2(level);
	return mapUv(uv, vec4(0, 1.0 - t, t, t * 0.5));
}
vec2 mapShinyUv(vec2 uv, float level) {
	float t = 1.0 / exp2(level);
	return mapUv(uv, vec4(1.0 - t, 1.0 - t, t, t * 0.5));
}
#endif
`;var EE=`
#ifdef LIT_SKYBOX_INTENSITY
	uniform float skyboxIntensity;
#endif
vec3 processEnvironment(vec3 color) {
	#ifdef LIT_SKYBOX_INTENSITY
		return color * skyboxIntensity;
	#else
		return color;
	#endif
}
`;var yE=`
float getFalloffWindow(float lightRadius, vec3 lightDir) {
	float sqrDist = dot(lightDir, lightDir);
	float invRadius = 1.0 / lightRadius;
	return square(saturate(1.0 - square(sqrDist * square(invRadius))));
}
float getFalloffInvSquared(float lightRadius, vec3 lightDir) {
	float sqrDist = dot(lightDir, lightDir);
	float falloff = 1.0 / (sqrDist + 1.0);
	float invRadius = 1.0 / lightRadius;
	falloff *= 16.0;
	falloff *= square(saturate(1.0 - square(sqrDist * square(invRadius))));
	return falloff;
}
`;var CE=`
float getFalloffLinear(float lightRadius, vec3 lightDir) {
	float d = length(lightDir);
	return max(((lightRadius - d) / lightRadius), 0.0);
}
`;var vE=`
#ifndef TBNBASIS
	#define TBNBASIS
	uniform float tbnBasis;
#endif
vec3 getFlatNormal(vec3 worldPos) {
	vec3 normal = cross(dFdx(worldPos), dFdy(worldPos));
	float basis = gl_FrontFacing ? tbnBasis : -tbnBasis;
	float len = length(normal);
	return len > 0.0 ? normal * (basis / len) : vec3(0.0, 1.0, 0.0);
}
`;var xE=`
#ifndef FLOAT_AS_UINT
#define FLOAT_AS_UINT
vec4 float2uint(float value) {
	uint intBits = floatBitsToUint(value);
	return vec4(
		float((intBits >> 24u) & 0xFFu) / 255.0,
		float((intBits >> 16u) & 0xFFu) / 255.0,
		float((intBits >> 8u) & 0xFFu) / 255.0,
		float(intBits & 0xFFu) / 255.0
	);
}
float uint2float(vec4 value) {
	uint intBits = 
		(uint(value.r * 255.0) << 24u) |
		(uint(value.g * 255.0) << 16u) |
		(uint(value.b * 255.0) << 8u) |
		uint(value.a * 255.0);
	return uintBitsToFloat(intBits);
}
vec4 float2vec4(float value) {
	#if defined(CAPS_TEXTURE_FLOAT_RENDERABLE)
		return vec4(value, 1.0, 1.0, 1.0);
	#else
		return float2uint(value);
	#endif
}
#endif
`;var AE=`
#ifndef SCENE_TEXTURES
#define SCENE_TEXTURES
void writeSceneTextureDepth(float linearDepth, float alpha) {
	#ifdef SCENE_TEXTURE_DEPTH
		pcFragColor{SCENE_TEXTURE_DEPTH_SLOT} = vec4(alpha / max(linearDepth, 1e-6), 0.0, 0.0, alpha);
	#endif
}
#endif
`;var RE=`
float dBlendModeFogFactor = 1.0;
#if (FOG != NONE)
	uniform vec3 fog_color;
	#if (FOG == LINEAR)
		uniform float fog_start;
		uniform float fog_end;
	#else
		uniform float fog_density;
	#endif
#endif
#ifdef VERTEXSHADER
	float getFogFactor(float depth) {
#else
	float getFogFactor() {
		float depth = gl_FragCoord.z / gl_FragCoord.w;
#endif
	float fogFactor = 0.0;
	#if (FOG == LINEAR)
		fogFactor = (fog_end - depth) / (fog_end - fog_start);
	#elif (FOG == EXP)
		fogFactor = exp(-depth * fog_density);
	#elif (FOG == EXP2)
		fogFactor = exp(-depth * depth * fog_density * fog_density);
	#endif
	return clamp(fogFactor, 0.0, 1.0);
}
#ifdef VERTEXSHADER
	vec3 addFog(vec3 color, float depth) {
		#if (FOG != NONE)
			return mix(fog_color * dBlendModeFogFactor, color, getFogFactor(depth));
		#endif
		return color;
	}
#else
	vec3 addFog(vec3 color) {
		#if (FOG != NONE)
			return mix(fog_color * dBlendModeFogFactor, color, getFogFactor());
		#endif
		return color;
	}
#endif
`;var PE=`
float pow5(float x) {
	float x2 = x * x;
	return x2 * x2 * x;
}
vec3 getFresnel(
		float cosTheta, 
		float gloss, 
		vec3 specularity
#if defined(LIT_IRIDESCENCE)
		, vec3 iridescenceFresnel, 
		float iridescenceIntensity
#endif
	) {
	float fresnel = pow5(1.0 - saturate(cosTheta));
	float glossSq = gloss * gloss;
	float specIntensity = max(specularity.r, max(specularity.g, specularity.b));
	vec3 ret = specularity + (max(vec3(glossSq * specIntensity), specularity) - specularity) * fresnel;
#if defined(LIT_IRIDESCENCE)
	return mix(ret, iridescenceFresnel, iridescenceIntensity);
#else
	return ret;
#endif	
}
float getFresnelCC(float cosTheta) {
	float fresnel = pow5(1.0 - saturate(cosTheta));
	return 0.04 + (1.0 - 0.04) * fresnel;
}
`;var DE=`
attribute vec2 vertex_position;
varying vec2 vUv0;
void main(void)
{
	gl_Position = vec4(vertex_position, 0.5, 1.0);
	vUv0 = vertex_position.xy * 0.5 + 0.5;
}
`;var IE=`
#include "decodePS"
#if (GAMMA == SRGB)
	float gammaCorrectInput(float color) {
		return decodeGamma(color);
	}
	vec3 gammaCorrectInput(vec3 color) {
		return decodeGamma(color);
	}
	vec4 gammaCorrectInput(vec4 color) {
		return vec4(decodeGamma(color.xyz), color.w);
	}
	vec3 gammaCorrectOutput(vec3 color) {
		return pow(color + 0.0000001, vec3(1.0 / 2.2));
	}
#else
	float gammaCorrectInput(float color) {
		return color;
	}
	vec3 gammaCorrectInput(vec3 color) {
		return color;
	}
	vec4 gammaCorrectInput(vec4 color) {
		return color;
	}
	vec3 gammaCorrectOutput(vec3 color) {
		return color;
	}
#endif
`;var wE=`
#ifdef STD_GLOSS_CONSTANT
uniform float material_gloss;
#endif
void getGlossiness() {
	dGlossiness = 1.0;
	#ifdef STD_GLOSS_CONSTANT
	dGlossiness *= material_gloss;
	#endif
	#ifdef STD_GLOSS_TEXTURE
	dGlossiness *= texture2DBias({STD_GLOSS_TEXTURE_NAME}, {STD_GLOSS_TEXTURE_UV}, {STD_TEXTURE_BIAS}).{STD_GLOSS_TEXTURE_CHANNEL};
	#endif
	#ifdef STD_GLOSS_VERTEX
	dGlossiness *= saturate(vVertexColor.{STD_GLOSS_VERTEX_CHANNEL});
	#endif
	#ifdef STD_GLOSS_INVERT
	dGlossiness = 1.0 - dGlossiness;
	#endif
	dGlossiness += 0.0000001;
}
`;var ME=`
	attribute vec2 aPosition;
	varying vec2 uv0;
	void main(void)
	{
		gl_Position = vec4(aPosition, 0.0, 1.0);
		uv0 = getImageEffectUV((aPosition.xy + 1.0) * 0.5);
	}
`;var LE=`
		#include "gammaPS"
		varying vec4 color;
		void main(void) {
			gl_FragColor = vec4(gammaCorrectOutput(decodeGamma(color.rgb)), color.a);
		}
`;var bE=`
	attribute vec4 vertex_position;
	attribute vec4 vertex_color;
	uniform mat4 matrix_model;
	uniform mat4 matrix_viewProjection;
	varying vec4 color;
	void main(void) {
		color = vertex_color;
		gl_Position = matrix_viewProjection * matrix_model * vertex_position;
	}
`;var FE=`
uniform float material_iridescenceRefractionIndex;
float iridescence_iorToFresnel(float transmittedIor, float incidentIor) {
	return pow((transmittedIor - incidentIor) / (transmittedIor + incidentIor), 2.0);
}
vec3 iridescence_iorToFresnel(vec3 transmittedIor, float incidentIor) {
	return pow((transmittedIor - vec3(incidentIor)) / (transmittedIor + vec3(incidentIor)), vec3(2.0));
}
vec3 iridescence_fresnelToIor(vec3 f0) {
	vec3 sqrtF0 = sqrt(f0);
	return (vec3(1.0) + sqrtF0) / (vec3(1.0) - sqrtF0);
}
vec3 iridescence_sensitivity(float opd, vec3 shift) {
	float PI = 3.141592653589793;
	float phase = 2.0 * PI * opd * 1.0e-9;
	const vec3 val = vec3(5.4856e-13, 4.4201e-13, 5.2481e-13);
	const vec3 pos = vec3(1.6810e+06, 1.7953e+06, 2.2084e+06);
	const vec3 var = vec3(4.3278e+09, 9.3046e+09, 6.6121e+09);
	vec3 xyz = val * sqrt(2.0 * PI * var) * cos(pos * phase + shift) * exp(-pow(phase, 2.0) * var);
	xyz.x += 9.7470e-14 * sqrt(2.0 * PI * 4.5282e+09) * cos(2.2399e+06 * phase + shift[0]) * exp(-4.5282e+09 * pow(phase, 2.0));
	xyz /= vec3(1.0685e-07);
	const mat3 XYZ_TO_REC709 = mat3(
		3.2404542, -0.9692660,  0.0556434,
	   -1.5371385,  1.8760108, -0.2040259,
	   -0.4985314,  0.0415560,  1.0572252
	);
	return XYZ_TO_REC709 * xyz;
}
float iridescence_fresnel(float cosTheta, float f0) {
	float x = clamp(1.0 - cosTheta, 0.0, 1.0);
	float x2 = x * x;
	float x5 = x * x2 * x2;
	return f0 + (1.0 - f0) * x5;
} 
vec3 iridescence_fresnel(float cosTheta, vec3 f0) {
	float x = clamp(1.0 - cosTheta, 0.0, 1.0);
	float x2 = x * x;
	float x5 = x * x2 * x2; 
	return f0 + (vec3(1.0) - f0) * x5;
}
vec3 calcIridescence(float outsideIor, float cosTheta, vec3 base_f0, float iridescenceThickness) {
	float PI = 3.141592653589793;
	float iridescenceIor = mix(outsideIor, material_iridescenceRefractionIndex, smoothstep(0.0, 0.03, iridescenceThickness));
	float sinTheta2Sq = pow(outsideIor / iridescenceIor, 2.0) * (1.0 - pow(cosTheta, 2.0));
	float cosTheta2Sq = 1.0 - sinTheta2Sq;
	if (cosTheta2Sq < 0.0) {
		return vec3(1.0);
	}
	float cosTheta2 = sqrt(cosTheta2Sq);
	float r0 = iridescence_iorToFresnel(iridescenceIor, outsideIor);
	float r12 = iridescence_fresnel(cosTheta, r0);
	float r21 = r12;
	float t121 = 1.0 - r12;
	float phi12 = iridescenceIor < outsideIor ? PI : 0.0;
	float phi21 = PI - phi12;
	vec3 baseIor = iridescence_fresnelToIor(base_f0 + vec3(0.0001));
	vec3 r1 = iridescence_iorToFresnel(baseIor, iridescenceIor);
	vec3 r23 = iridescence_fresnel(cosTheta2, r1);
	vec3 phi23 = vec3(0.0);
	if (baseIor[0] < iridescenceIor) phi23[0] = PI;
	if (baseIor[1] < iridescenceIor) phi23[1] = PI;
	if (baseIor[2] < iridescenceIor) phi23[2] = PI;
	float opd = 2.0 * iridescenceIor * iridescenceThickness * cosTheta2;
	vec3 phi = vec3(phi21) + phi23; 
	vec3 r123Sq = clamp(r12 * r23, 1e-5, 0.9999);
	vec3 r123 = sqrt(r123Sq);
	vec3 rs = pow(t121, 2.0) * r23 / (1.0 - r123Sq);
	vec3 c0 = r12 + rs;
	vec3 i = c0;
	vec3 cm = rs - t121;
	for (int m = 1; m <= 2; m++) {
		cm *= r123;
		vec3 sm = 2.0 * iridescence_sensitivity(float(m) * opd, float(m) * phi);
		i += cm * sm;
	}
	return max(i, vec3(0.0));
}
vec3 getIridescence(float cosTheta, vec3 specularity, float iridescenceThickness) {
	return calcIridescence(1.0, cosTheta, specularity, iridescenceThickness);
}
`;var OE=`
#ifdef STD_IRIDESCENCE_CONSTANT
uniform float material_iridescence;
#endif
void getIridescence() {
	float iridescence = 1.0;
	#ifdef STD_IRIDESCENCE_CONSTANT
	iridescence *= material_iridescence;
	#endif
	#ifdef STD_IRIDESCENCE_TEXTURE
	iridescence *= texture2DBias({STD_IRIDESCENCE_TEXTURE_NAME}, {STD_IRIDESCENCE_TEXTURE_UV}, {STD_TEXTURE_BIAS}).{STD_IRIDESCENCE_TEXTURE_CHANNEL};
	#endif
	dIridescence = iridescence; 
}
`;var NE=`
uniform float material_iridescenceThicknessMax;
#ifdef STD_IRIDESCENCETHICKNESS_TEXTURE
uniform float material_iridescenceThicknessMin;
#endif
void getIridescenceThickness() {
	#ifdef STD_IRIDESCENCETHICKNESS_TEXTURE
		float blend = texture2DBias({STD_IRIDESCENCETHICKNESS_TEXTURE_NAME}, {STD_IRIDESCENCETHICKNESS_TEXTURE_UV}, {STD_TEXTURE_BIAS}).{STD_IRIDESCENCETHICKNESS_TEXTURE_CHANNEL};
		float iridescenceThickness = mix(material_iridescenceThicknessMin, material_iridescenceThicknessMax, blend);
	#else
		float iridescenceThickness = material_iridescenceThicknessMax;
	#endif
	dIridescenceThickness = iridescenceThickness; 
}
`;var BE=`
#ifdef STD_IOR_CONSTANT
uniform float material_refractionIndex;
#endif
void getIor() {
#ifdef STD_IOR_CONSTANT
	dIor = material_refractionIndex;
#else
	dIor = 1.0 / 1.5;
#endif
}
`;var UE=`
#if defined(LIGHT{i})
	uniform vec3 light{i}_color;
	#if LIGHT{i}TYPE == DIRECTIONAL
		uniform vec3 light{i}_direction;
	#else
		#define LIT_CODE_LIGHTS_POINT
		uniform vec3 light{i}_position;
		uniform float light{i}_radius;
		#if LIGHT{i}TYPE == SPOT
			#define LIT_CODE_LIGHTS_SPOT
			uniform vec3 light{i}_direction;
			uniform float light{i}_innerConeAngle;
			uniform float light{i}_outerConeAngle;
		#endif
	#endif
	#if LIGHT{i}SHAPE != PUNCTUAL
		#define LIT_CODE_FALLOFF_SQUARED
		#if LIGHT{i}TYPE == DIRECTIONAL
			uniform vec3 light{i}_position;
		#endif
		uniform vec3 light{i}_halfWidth;
		uniform vec3 light{i}_halfHeight;
	#else
		#if LIGHT{i}FALLOFF == LINEAR
			#define LIT_CODE_FALLOFF_LINEAR
		#endif
		#if LIGHT{i}FALLOFF == INVERSESQUARED
			#define LIT_CODE_FALLOFF_SQUARED
		#endif
	#endif
	#if defined(LIGHT{i}CASTSHADOW)
		#if LIGHT{i}TYPE != OMNI
			uniform mat4 light{i}_shadowMatrix;
		#endif
		uniform float light{i}_shadowIntensity;
		uniform vec4 light{i}_shadowParams;
		#if LIGHT{i}SHADOWTYPE == PCSS_32F
			uniform float light{i}_shadowSearchArea;
			uniform vec4 light{i}_cameraParams;
			#if LIGHT{i}TYPE == DIRECTIONAL
				uniform vec4 light{i}_softShadowParams;
				uniform mat4 light{i}_shadowCascadeParams;
			#endif
		#endif
		#if LIGHT{i}TYPE == DIRECTIONAL
			uniform mat4 light{i}_shadowMatrixPalette[4];
			uniform vec4 light{i}_shadowCascadeDistances;
			uniform int light{i}_shadowCascadeCount;
			uniform float light{i}_shadowCascadeBlend;
		#endif
		#if LIGHT{i}TYPE == OMNI
			#if defined(LIGHT{i}SHADOW_PCF)
				uniform samplerCubeShadow light{i}_shadowMap;
			#else
				uniform samplerCube light{i}_shadowMap;
			#endif
		#else
			#if defined(LIGHT{i}SHADOW_PCF)
				uniform sampler2DShadow light{i}_shadowMap;
			#else
				uniform sampler2D light{i}_shadowMap;
			#endif
		#endif
	#endif
	#if defined(LIGHT{i}COOKIE)
		#define LIT_CODE_COOKIE
		#if LIGHT{i}TYPE == OMNI
			uniform samplerCube light{i}_cookie;
			uniform float light{i}_cookieIntensity;
			uniform mat4 light{i}_shadowMatrix;
		#endif
		#if LIGHT{i}TYPE == SPOT
			uniform sampler2D light{i}_cookie;
			uniform float light{i}_cookieIntensity;
			#if !defined(LIGHT{i}CASTSHADOW)
				uniform mat4 light{i}_shadowMatrix;
			#endif
			#if defined(LIGHT{i}COOKIE_TRANSFORM)
				uniform vec4 light{i}_cookieMatrix;
				uniform vec2 light{i}_cookieOffset;
			#endif
		#endif
	#endif
#endif
`;var kE=`
float getLightDiffuse(vec3 worldNormal, vec3 viewDir, vec3 lightDirNorm) {
	return max(dot(worldNormal, -lightDirNorm), 0.0);
}
`;var GE=`
vec3 evalOmniLight(vec3 lightPosW) {
	return vPositionW - lightPosW;
}
`;var VE=`
#if defined(LIGHT{i})
	evaluateLight{i}(
		#if defined(LIT_IRIDESCENCE)
			iridescenceFresnel
		#endif
	);
#endif
`;var zE=`
#if defined(LIGHT{i})
void evaluateLight{i}(
	#if defined(LIT_IRIDESCENCE)
		vec3 iridescenceFresnel
	#endif
) {
	vec3 lightColor = light{i}_color;
	#if LIGHT{i}TYPE == DIRECTIONAL && !defined(LIT_SHADOW_CATCHER)
		if (all(equal(lightColor, vec3(0.0)))) {
			return;
		}
	#endif
	#if LIGHT{i}TYPE == DIRECTIONAL
		dLightDirNormW = light{i}_direction;
		dAtten = 1.0;
	#else
		
		vec3 lightDirW = evalOmniLight(light{i}_position);
		dLightDirNormW = normalize(lightDirW);
		#if defined(LIGHT{i}COOKIE)
			#if LIGHT{i}TYPE == SPOT
				#ifdef LIGHT{i}COOKIE_FALLOFF
					#ifdef LIGHT{i}COOKIE_TRANSFORM
						vec3 cookieAttenuation = getCookie2DXform(light{i}_cookie, light{i}_shadowMatrix, light{i}_cookieIntensity, light{i}_cookieMatrix, light{i}_cookieOffset).{LIGHT{i}COOKIE_CHANNEL};
					#else
						vec3 cookieAttenuation = getCookie2D(light{i}_cookie, light{i}_shadowMatrix, light{i}_cookieIntensity).{LIGHT{i}COOKIE_CHANNEL};
					#endif
				#else
					#ifdef LIGHT{i}COOKIE_TRANSFORM
						vec3 cookieAttenuation = getCookie2DClipXform(light{i}_cookie, light{i}_shadowMatrix, light{i}_cookieIntensity, light{i}_cookieMatrix, light{i}_cookieOffset).{LIGHT{i}COOKIE_CHANNEL};
					#else
						vec3 cookieAttenuation = getCookie2DClip(light{i}_cookie, light{i}_shadowMatrix, light{i}_cookieIntensity).{LIGHT{i}COOKIE_CHANNEL};
					#endif
				#endif
			#endif
			#if LIGHT{i}TYPE == OMNI
				vec3 cookieAttenuation = getCookieCube(light{i}_cookie, light{i}_shadowMatrix, light{i}_cookieIntensity).{LIGHT{i}COOKIE_CHANNEL};
			#endif
			lightColor *= cookieAttenuation;
		#endif
		#if LIGHT{i}SHAPE == PUNCTUAL
			#if LIGHT{i}FALLOFF == LINEAR
				dAtten = getFalloffLinear(light{i}_radius, lightDirW);
			#else
				dAtten = getFalloffInvSquared(light{i}_radius, lightDirW);
			#endif
		#else
			dAtten = getFalloffWindow(light{i}_radius, lightDirW);
		#endif
		#if LIGHT{i}TYPE == SPOT
			#if !defined(LIGHT{i}COOKIE) || defined(LIGHT{i}COOKIE_FALLOFF)
				dAtten *= getSpotEffect(light{i}_direction, light{i}_innerConeAngle, light{i}_outerConeAngle, dLightDirNormW);
			#endif
		#endif
	#endif
	if (dAtten < 0.00001) {
		return;
	}
	#if LIGHT{i}SHAPE != PUNCTUAL
		#if LIGHT{i}SHAPE == RECT
			calcRectLightValues(light{i}_position, light{i}_halfWidth, light{i}_halfHeight);
		#elif LIGHT{i}SHAPE == DISK
			calcDiskLightValues(light{i}_position, light{i}_halfWidth, light{i}_halfHeight);
		#elif LIGHT{i}SHAPE == SPHERE
			calcSphereLightValues(light{i}_position, light{i}_halfWidth, light{i}_halfHeight);
		#endif
	#endif
	#if LIGHT{i}SHAPE != PUNCTUAL
		#if LIGHT{i}TYPE == DIRECTIONAL
			float attenDiffuse = getLightDiffuse(litArgs_worldNormal, dViewDirW, dLightDirNormW);
		#else
			#if LIGHT{i}SHAPE == RECT
				float attenDiffuse = getRectLightDiffuse(litArgs_worldNormal, dViewDirW, lightDirW, dLightDirNormW) * 16.0;
			#elif LIGHT{i}SHAPE == DISK
				float attenDiffuse = getDiskLightDiffuse(litArgs_worldNormal, dViewDirW, lightDirW, dLightDirNormW) * 16.0;
			#elif LIGHT{i}SHAPE == SPHERE
				float attenDiffuse = getSphereLightDiffuse(litArgs_worldNormal, dViewDirW, lightDirW, dLightDirNormW) * 16.0;
			#endif
		#endif
	#else
		dAtten *= getLightDiffuse(litArgs_worldNormal, vec3(0.0), dLightDirNormW);
	#endif
	#ifdef LIGHT{i}CASTSHADOW
		#if LIGHT{i}TYPE == DIRECTIONAL
			float shadow = getShadow{i}(vec3(0.0));
		#else
			float shadow = getShadow{i}(lightDirW);
		#endif
		#ifdef LIGHT{i}_SHADOW_CASCADE_BLEND
			float shadowDistance = light{i}_shadowCascadeDistances.w;
			float shadowFade = smoothstep(light{i}_shadowCascadeBlend * shadowDistance, shadowDistance, 1.0 / gl_FragCoord.w);
			shadow = mix(shadow, 1.0, shadowFade);
		#endif
		shadow = mix(1.0, shadow, light{i}_shadowIntensity);
		dAtten *= shadow;
		#if defined(LIT_SHADOW_CATCHER) && LIGHT{i}TYPE == DIRECTIONAL
			dShadowCatcher *= shadow;
		#endif			
	#endif
	#if defined(STD_PARALLAX_SELF_SHADOW) && LIGHT{i}TYPE == DIRECTIONAL
		dAtten *= getParallaxSelfShadow(dLightDirNormW);
	#endif
	#if LIGHT{i}SHAPE != PUNCTUAL
		#ifdef LIT_SPECULAR
			dDiffuseLight += ((attenDiffuse * dAtten) * lightColor) * (1.0 - dLTCSpecFres);
		#else
			dDiffuseLight += (attenDiffuse * dAtten) * lightColor;
		#endif						
	#else
		#if defined(AREA_LIGHTS) && defined(LIT_SPECULAR)
			dDiffuseLight += (dAtten * lightColor) * (1.0 - litArgs_specularity);
		#else
			dDiffuseLight += dAtten * lightColor;
		#endif
	#endif
	#ifdef LIGHT{i}AFFECT_SPECULARITY
		#if LIGHT{i}SHAPE != PUNCTUAL
			#ifdef LIT_CLEARCOAT
				#if LIGHT{i}SHAPE == RECT
					ccSpecularLight += ccLTCSpecFres * getRectLightSpecular(litArgs_clearcoat_worldNormal, dViewDirW) * dAtten * lightColor;
				#elif LIGHT{i}SHAPE == DISK
					ccSpecularLight += ccLTCSpecFres * getDiskLightSpecular(litArgs_clearcoat_worldNormal, dViewDirW) * dAtten * lightColor;
				#elif LIGHT{i}SHAPE == SPHERE
					ccSpecularLight += ccLTCSpecFres * getSphereLightSpecular(litArgs_clearcoat_worldNormal, dViewDirW) * dAtten * lightColor;
				#endif
			#endif
			#ifdef LIT_SPECULAR
				#if LIGHT{i}SHAPE == RECT
					dSpecularLight += dLTCSpecFres * getRectLightSpecular(litArgs_worldNormal, dViewDirW) * dAtten * lightColor;
				#elif LIGHT{i}SHAPE == DISK
					dSpecularLight += dLTCSpecFres * getDiskLightSpecular(litArgs_worldNormal, dViewDirW) * dAtten * lightColor;
				#elif LIGHT{i}SHAPE == SPHERE
					dSpecularLight += dLTCSpecFres * getSphereLightSpecular(litArgs_worldNormal, dViewDirW) * dAtten * lightColor;
				#endif
			#endif
		#else
			#if LIGHT{i}TYPE == DIRECTIONAL && LIT_FRESNEL_MODEL != NONE
				#define LIGHT{i}FRESNEL
			#endif
			#ifdef LIT_SPECULAR
				vec3 halfDirW = normalize(-dLightDirNormW + dViewDirW);
			#endif
			#ifdef LIT_CLEARCOAT
				vec3 lightspecularCC = getLightSpecular(halfDirW, ccReflDirW, litArgs_clearcoat_worldNormal, dViewDirW, dLightDirNormW, litArgs_clearcoat_gloss, dTBN) * dAtten * lightColor;
				#ifdef LIGHT{i}FRESNEL
					lightspecularCC *= getFresnelCC(dot(dViewDirW, halfDirW));
				#endif
				ccSpecularLight += lightspecularCC;
			#endif
			#ifdef LIT_SHEEN
				sSpecularLight += getLightSpecularSheen(halfDirW, litArgs_worldNormal, dViewDirW, dLightDirNormW, litArgs_sheen_gloss) * dAtten * lightColor;
			#endif
			#ifdef LIT_SPECULAR
				vec3 lightSpecular = getLightSpecular(halfDirW, dReflDirW, litArgs_worldNormal, dViewDirW, dLightDirNormW, litArgs_gloss, dTBN) * dAtten * lightColor;
				#ifdef LIGHT{i}FRESNEL
					#if defined(LIT_IRIDESCENCE)
						lightSpecular *= getFresnel(dot(dViewDirW, halfDirW), litArgs_gloss, litArgs_specularity, iridescenceFresnel, litArgs_iridescence_intensity);
					#else
						lightSpecular *= getFresnel(dot(dViewDirW, halfDirW), litArgs_gloss, litArgs_specularity);
					#endif
				#else
					lightSpecular *= litArgs_specularity;
				#endif
				
				dSpecularLight += lightSpecular;
			#endif
		#endif
	#endif
}
#endif
`;var HE=`
#ifdef LIGHT{i}CASTSHADOW
	#ifdef LIGHT{i}_SHADOW_SAMPLE_POINT
		vec3 getShadowSampleCoordOmni{i}(vec4 shadowParams, vec3 worldPosition, vec3 lightPos, inout vec3 lightDir, vec3 lightDirNorm, vec3 normal) {
			#ifdef LIGHT{i}_SHADOW_SAMPLE_NORMAL_OFFSET
				float distScale = length(lightDir);
				vec3 surfacePosition = worldPosition + normal * shadowParams.y * clamp(1.0 - dot(normal, -lightDirNorm), 0.0, 1.0) * distScale;
				lightDir = surfacePosition - lightPos;
			#endif
			return lightDir;
		}
	#endif
	#ifndef LIGHT{i}_SHADOW_SAMPLE_POINT
		vec3 getShadowSampleCoord{i}(mat4 shadowTransform, vec4 shadowParams, vec3 worldPosition, vec3 lightPos, inout vec3 lightDir, vec3 lightDirNorm, vec3 normal) {
			vec3 surfacePosition = worldPosition;
			#ifdef LIGHT{i}_SHADOW_SAMPLE_SOURCE_ZBUFFER
				#ifdef LIGHT{i}_SHADOW_SAMPLE_NORMAL_OFFSET
					surfacePosition = surfacePosition + normal * shadowParams.y;
				#endif
			#else
				#ifdef LIGHT{i}_SHADOW_SAMPLE_NORMAL_OFFSET
					#ifdef LIGHT{i}_SHADOW_SAMPLE_ORTHO
						float distScale = 1.0;
					#else
						float distScale = abs(dot(worldPosition - lightPos, lightDirNorm));
					#endif
					surfacePosition = surfacePosition + normal * shadowParams.y * clamp(1.0 - dot(normal, -lightDirNorm), 0.0, 1.0) * distScale;
				#endif
			#endif
			vec4 positionInShadowSpace = shadowTransform * vec4(surfacePosition, 1.0);
			#ifdef LIGHT{i}_SHADOW_SAMPLE_ORTHO
				positionInShadowSpace.z = saturate(positionInShadowSpace.z) - 0.0001;
			#else
				#ifdef LIGHT{i}_SHADOW_SAMPLE_SOURCE_ZBUFFER
					positionInShadowSpace.xyz /= positionInShadowSpace.w;
				#else
					positionInShadowSpace.xy /= positionInShadowSpace.w;
					positionInShadowSpace.z = length(lightDir) * shadowParams.w;
				#endif
			#endif
			return positionInShadowSpace.xyz;
		}
	#endif
	float getShadow{i}(vec3 lightDirW) {
		#if LIGHT{i}TYPE == DIRECTIONAL
			if (1.0 / gl_FragCoord.w > light{i}_shadowCascadeDistances.w) {
				return 1.0;
			}
		#endif
		#if LIGHT{i}TYPE == OMNI
			vec3 shadowCoord = getShadowSampleCoordOmni{i}(light{i}_shadowParams, vPositionW, light{i}_position, lightDirW, dLightDirNormW, dVertexNormalW);
		#else
			#ifdef LIGHT{i}_SHADOW_CASCADES
				int cascadeIndex = getShadowCascadeIndex(light{i}_shadowCascadeDistances, light{i}_shadowCascadeCount);
				#ifdef LIGHT{i}_SHADOW_CASCADE_BLEND
					cascadeIndex = ditherShadowCascadeIndex(cascadeIndex, light{i}_shadowCascadeDistances, light{i}_shadowCascadeCount, light{i}_shadowCascadeBlend);
				#endif
				mat4 shadowMatrix = light{i}_shadowMatrixPalette[cascadeIndex];
			#else
				mat4 shadowMatrix = light{i}_shadowMatrix;
			#endif
			#if LIGHT{i}TYPE == DIRECTIONAL
				vec3 shadowCoord = getShadowSampleCoord{i}(shadowMatrix, light{i}_shadowParams, vPositionW, vec3(0.0), lightDirW, dLightDirNormW, dVertexNormalW);
			#else
				vec3 shadowCoord = getShadowSampleCoord{i}(shadowMatrix, light{i}_shadowParams, vPositionW, light{i}_position, lightDirW, dLightDirNormW, dVertexNormalW);
			#endif
		#endif
		#if LIGHT{i}TYPE == DIRECTIONAL
			#if LIGHT{i}SHADOWTYPE == VSM_16F
				return getShadowVSM16(SHADOWMAP_PASS(light{i}_shadowMap), shadowCoord, light{i}_shadowParams, 5.54);
			#endif
			#if LIGHT{i}SHADOWTYPE == VSM_32F
				return getShadowVSM32(SHADOWMAP_PASS(light{i}_shadowMap), shadowCoord, light{i}_shadowParams, 15.0);
			#endif
			#if LIGHT{i}SHADOWTYPE == PCSS_32F
				#if LIGHT{i}SHAPE != PUNCTUAL
					vec2 shadowSearchArea = vec2(length(light{i}_halfWidth), length(light{i}_halfHeight)) * light{i}_shadowSearchArea;
					return getShadowPCSS(SHADOWMAP_PASS(light{i}_shadowMap), shadowCoord, light{i}_shadowParams, light{i}_cameraParams, shadowSearchArea, lightDirW);
				#else
					vec4 pcssCameraParams = light{i}_cameraParams;
					#ifdef LIGHT{i}_SHADOW_CASCADES
						pcssCameraParams = light{i}_shadowCascadeParams[cascadeIndex];
					#endif
					return getShadowPCSS(SHADOWMAP_PASS(light{i}_shadowMap), shadowCoord, light{i}_shadowParams, pcssCameraParams, light{i}_softShadowParams, lightDirW);
				#endif
			#endif
			#if LIGHT{i}SHADOWTYPE == PCF1_16F || LIGHT{i}SHADOWTYPE == PCF1_32F
				return getShadowPCF1x1(SHADOWMAP_PASS(light{i}_shadowMap), shadowCoord, light{i}_shadowParams);
			#endif
			#if LIGHT{i}SHADOWTYPE == PCF3_16F || LIGHT{i}SHADOWTYPE == PCF3_32F
				return getShadowPCF3x3(SHADOWMAP_PASS(light{i}_shadowMap), shadowCoord, light{i}_shadowParams);
			#endif
			#if LIGHT{i}SHADOWTYPE == PCF5_16F || LIGHT{i}SHADOWTYPE == PCF5_32F
				return getShadowPCF5x5(SHADOWMAP_PASS(light{i}_shadowMap), shadowCoord, light{i}_shadowParams);
			#endif
		#endif
		#if LIGHT{i}TYPE == SPOT
			#if LIGHT{i}SHADOWTYPE == VSM_16F
				return getShadowSpotVSM16(SHADOWMAP_PASS(light{i}_shadowMap), shadowCoord, light{i}_shadowParams, 5.54, lightDirW);
			#endif
			#if LIGHT{i}SHADOWTYPE == VSM_32F
				return getShadowSpotVSM32(SHADOWMAP_PASS(light{i}_shadowMap), shadowCoord, light{i}_shadowParams, 15.0, lightDirW);
			#endif
			#if LIGHT{i}SHADOWTYPE == PCSS_32F
				#if LIGHT{i}SHAPE != PUNCTUAL
					vec2 shadowSearchArea = vec2(length(light{i}_halfWidth), length(light{i}_halfHeight)) * light{i}_shadowSearchArea;
				#else
					vec2 shadowSearchArea = vec2(light{i}_shadowSearchArea);
				#endif
				return getShadowSpotPCSS(SHADOWMAP_PASS(light{i}_shadowMap), shadowCoord, light{i}_shadowParams, light{i}_cameraParams, shadowSearchArea, lightDirW);
			#endif
			#if LIGHT{i}SHADOWTYPE == PCF1_16F || LIGHT{i}SHADOWTYPE == PCF1_32F
				return getShadowSpotPCF1x1(SHADOWMAP_PASS(light{i}_shadowMap), shadowCoord, light{i}_shadowParams);
			#endif
			#if LIGHT{i}SHADOWTYPE == PCF3_16F || LIGHT{i}SHADOWTYPE == PCF3_32F
				return getShadowSpotPCF3x3(SHADOWMAP_PASS(light{i}_shadowMap), shadowCoord, light{i}_shadowParams);
			#endif
			#if LIGHT{i}SHADOWTYPE == PCF5_16F || LIGHT{i}SHADOWTYPE == PCF5_32F
				return getShadowSpotPCF5x5(SHADOWMAP_PASS(light{i}_shadowMap), shadowCoord, light{i}_shadowParams);
			#endif
		#endif
		#if LIGHT{i}TYPE == OMNI
			#if LIGHT{i}SHADOWTYPE == PCSS_32F
				#if LIGHT{i}SHAPE != PUNCTUAL
					vec2 shadowSearchArea = vec2(length(light{i}_halfWidth), length(light{i}_halfHeight)) * light{i}_shadowSearchArea;
				#else
					vec2 shadowSearchArea = vec2(light{i}_shadowSearchArea);
				#endif
				return getShadowOmniPCSS(SHADOWMAP_PASS(light{i}_shadowMap), shadowCoord, light{i}_shadowParams, light{i}_cameraParams, shadowSearchArea, lightDirW);
			#endif
			#if LIGHT{i}SHADOWTYPE == PCF1_16F || LIGHT{i}SHADOWTYPE == PCF1_32F
				return getShadowOmniPCF1x1(SHADOWMAP_PASS(light{i}_shadowMap), shadowCoord, light{i}_shadowParams, lightDirW);
			#endif
			#if LIGHT{i}SHADOWTYPE == PCF3_16F || LIGHT{i}SHADOWTYPE == PCF3_32F
				return getShadowOmniPCF3x3(SHADOWMAP_PASS(light{i}_shadowMap), shadowCoord, light{i}_shadowParams, lightDirW);
			#endif
		#endif
	}
#endif
`;var WE=`
#ifdef LIT_CLUSTERED_LIGHTS
	#define LIT_CODE_FALLOFF_LINEAR
	#define LIT_CODE_FALLOFF_SQUARED
	#define LIT_CODE_LIGHTS_POINT
	#define LIT_CODE_LIGHTS_SPOT
#endif
#ifdef AREA_LIGHTS
	uniform highp sampler2D areaLightsLutTex1;
	uniform highp sampler2D areaLightsLutTex2;
#endif
#ifdef LIT_LIGHTING
	#include "lightDiffuseLambertPS"
	#if defined(AREA_LIGHTS) || defined(LIT_CLUSTERED_AREA_LIGHTS)
		#include "ltcPS"
	#endif
#endif
#ifdef SHADOW_DIRECTIONAL
	#include "shadowCascadesPS"
#endif
#if defined(SHADOW_KIND_PCF1)
	#include "shadowPCF1PS"
#endif
#if defined(SHADOW_KIND_PCF3)
	#include "shadowPCF3PS"
#endif
#if defined(SHADOW_KIND_PCF5)
	#include "shadowPCF5PS"
#endif
#if defined(SHADOW_KIND_PCSS)
	#include "linearizeDepthPS"
	#include "shadowPCSSPS"
	#include "shadowSoftPS"
#endif
#if defined(SHADOW_KIND_VSM)
	#include "shadowEVSMPS"
#endif
#ifdef LIT_CODE_FALLOFF_LINEAR
	#include "falloffLinearPS"
#endif
#ifdef LIT_CODE_FALLOFF_SQUARED
	#include "falloffInvSquaredPS"
#endif
#ifdef LIT_CODE_LIGHTS_POINT
	#include "lightDirPointPS"
#endif
#ifdef LIT_CODE_LIGHTS_SPOT
	#include "spotPS"
#endif
#ifdef LIT_CODE_COOKIE
	#include "cookiePS"
#endif
#ifdef LIT_CLUSTERED_LIGHTS
	#include "clusteredLightPS"
#endif
#ifdef LIGHT_COUNT > 0
	#include "lightFunctionShadowPS, LIGHT_COUNT"
	#include "lightFunctionLightPS, LIGHT_COUNT"
#endif
`;var XE=`
void addLightMap(
	vec3 lightmap, 
	vec3 dir, 
	vec3 worldNormal, 
	vec3 viewDir, 
	vec3 reflectionDir, 
	float gloss, 
	vec3 specularity, 
	vec3 vertexNormal, 
	mat3 tbn
#if defined(LIT_IRIDESCENCE)
	vec3 iridescenceFresnel, 
	float iridescenceIntensity
#endif
) {
	#if defined(LIT_SPECULAR) && defined(LIT_DIR_LIGHTMAP)
		if (dot(dir, dir) < 0.0001) {
				dDiffuseLight += lightmap;
		} else {
			float vlight = saturate(dot(dir, -vertexNormal));
			float flight = saturate(dot(dir, -worldNormal));
			float nlight = (flight / max(vlight, 0.01)) * 0.5;
			dDiffuseLight += lightmap * nlight * 2.0;
			vec3 halfDir = normalize(-dir + viewDir);
			vec3 specularLight = lightmap * getLightSpecular(halfDir, reflectionDir, worldNormal, viewDir, dir, gloss, tbn);
			#ifdef LIT_SPECULAR_FRESNEL
				specularLight *= 
					getFresnel(dot(viewDir, halfDir), 
					gloss, 
					specularity
				#if defined(LIT_IRIDESCENCE)
					, iridescenceFresnel,
					iridescenceIntensity
				#endif
					);
			#endif
			dSpecularLight += specularLight;
		}
	#else
		dDiffuseLight += lightmap;
	#endif
}
`;var YE=`
#ifdef STD_LIGHTMAP_DIR
	vec3 dLightmapDir;
	uniform sampler2D texture_dirLightMap;
#endif
void getLightMap() {
	dLightmap = vec3(1.0);
	#ifdef STD_LIGHT_TEXTURE
		dLightmap *= {STD_LIGHT_TEXTURE_DECODE}(texture2DBias({STD_LIGHT_TEXTURE_NAME}, {STD_LIGHT_TEXTURE_UV}, {STD_TEXTURE_BIAS})).{STD_LIGHT_TEXTURE_CHANNEL};
		#ifdef STD_LIGHTMAP_DIR
			vec3 dir = texture2DBias(texture_dirLightMap, {STD_LIGHT_TEXTURE_UV}, {STD_TEXTURE_BIAS}).xyz * 2.0 - 1.0;
			float dirDot = dot(dir, dir);
			dLightmapDir = (dirDot > 0.001) ? dir / sqrt(dirDot) : vec3(0.0);
		#endif
	#endif
	#ifdef STD_LIGHT_VERTEX
		dLightmap *= saturate(vVertexColor.{STD_LIGHT_VERTEX_CHANNEL});
	#endif
}
`;var jE=`
float calcLightSpecular(float gloss, vec3 worldNormal, vec3 viewDir, vec3 h, vec3 lightDirNorm, mat3 tbn) {
	float PI = 3.141592653589793;
	float roughness = max((1.0 - gloss) * (1.0 - gloss), 0.001);
	float alphaRoughness = roughness * roughness;
	float anisotropy = dAnisotropy;
	vec2 direction = dAnisotropyRotation;
	float at = mix(alphaRoughness, 1.0, anisotropy * anisotropy);
	float ab = clamp(alphaRoughness, 0.001, 1.0);
	vec3 anisotropicT = normalize(tbn * vec3(direction, 0.0));
	vec3 anisotropicB = normalize(cross(tbn[2], anisotropicT));
	float NoH = dot(worldNormal, h);
	float ToH = dot(anisotropicT, h);
	float BoH = dot(anisotropicB, h);
	float a2 = at * ab;
	vec3 v = vec3(ab * ToH, at * BoH, a2 * NoH);
	float v2 = dot(v, v);
	float w2 = a2 / v2;
	float D = a2 * w2 * w2 * (1.0 / PI);
	float ToV = dot(anisotropicT, viewDir);
	float BoV = dot(anisotropicB, viewDir);
	float ToL = dot(anisotropicT, -lightDirNorm);
	float BoL = dot(anisotropicB, -lightDirNorm);
	float NoV = dot(worldNormal, viewDir);
	float NoL = dot(worldNormal, -lightDirNorm);
	float lambdaV = NoL * length(vec3(at * ToV, ab * BoV, NoV));
	float lambdaL = NoV * length(vec3(at * ToL, ab * BoL, NoL));
	float G = 0.5 / (lambdaV + lambdaL);
	return D * G;
}
float getLightSpecular(vec3 h, vec3 reflDir, vec3 worldNormal, vec3 viewDir, vec3 lightDirNorm, float gloss, mat3 tbn) {
	return calcLightSpecular(gloss, worldNormal, viewDir, h, lightDirNorm, tbn);
}
`;var qE=`
float calcLightSpecular(float gloss, vec3 worldNormal, vec3 viewDir, vec3 h, vec3 lightDirNorm) {
	const float PI = 3.141592653589793;
	float roughness = max((1.0 - gloss) * (1.0 - gloss), 0.001);
	float alpha = roughness * roughness;
	float NoH = max(dot(worldNormal, h), 0.0);
	float NoV = max(dot(worldNormal, viewDir), 0.0);
	float NoL = max(dot(worldNormal, -lightDirNorm), 0.0);
	float NoH2 = NoH * NoH;
	float denom = NoH2 * (alpha - 1.0) + 1.0;
	float D = alpha / (PI * denom * denom);
	float alpha2 = alpha * alpha;
	float lambdaV = NoL * sqrt(NoV * NoV * (1.0 - alpha2) + alpha2);
	float lambdaL = NoV * sqrt(NoL * NoL * (1.0 - alpha2) + alpha2);
	float G = 0.5 / max(lambdaV + lambdaL, 0.00001);
	return D * G;
}
float getLightSpecular(vec3 h, vec3 reflDir, vec3 worldNormal, vec3 viewDir, vec3 lightDirNorm, float gloss, mat3 tbn) {
	return calcLightSpecular(gloss, worldNormal, viewDir, h, lightDirNorm);
}
`;var $E=`
float calcLightSpecular(float gloss, vec3 worldNormal, vec3 h) {
	float nh = max( dot( h, worldNormal ), 0.0 );
	float specPow = exp2(gloss * 11.0);
	specPow = max(specPow, 0.0001);
	return pow(nh, specPow) * (specPow + 2.0) / 8.0;
}
float getLightSpecular(vec3 h, vec3 reflDir, vec3 worldNormal, vec3 viewDir, vec3 lightDirNorm, float gloss, mat3 tbn) {
	return calcLightSpecular(gloss, worldNormal, h);
}
`;var KE=`
float sheenD(vec3 normal, vec3 h, float roughness) {
	const float PI = 3.141592653589793;
	float invR = 1.0 / (roughness * roughness);
	float cos2h = max(dot(normal, h), 0.0);
	cos2h *= cos2h;
	float sin2h = max(1.0 - cos2h, 0.0078125);
	return (2.0 + invR) * pow(sin2h, invR * 0.5) / (2.0 * PI);
}
float sheenV(vec3 normal, vec3 viewDir, vec3 light) {
	float NoV = max(dot(normal, viewDir), 0.000001);
	float NoL = max(dot(normal, light), 0.000001);
	return 1.0 / (4.0 * (NoL + NoV - NoL * NoV));
}
float getLightSpecularSheen(vec3 h, vec3 worldNormal, vec3 viewDir, vec3 lightDirNorm, float sheenGloss) {
	float D = sheenD(worldNormal, h, sheenGloss);
	float V = sheenV(worldNormal, viewDir, -lightDirNorm);
	return D * V;
}
`;var ZE=`
#ifndef LINEARIZE_DEPTH
#define LINEARIZE_DEPTH
float linearizeDepthWithParams(float z, vec4 cameraParams) {
	if (cameraParams.w == 0.0)
		return (cameraParams.z * cameraParams.y) / (cameraParams.y + z * (cameraParams.z - cameraParams.y));
	else
		return cameraParams.z + z * (cameraParams.y - cameraParams.z);
}
#ifndef CAMERAPLANES
	#define CAMERAPLANES
	uniform vec4 camera_params;
#endif
float linearizeDepth(float z) {
	return linearizeDepthWithParams(z, camera_params);
}
#endif
`;var QE=`
void evaluateBackend() {
	#ifdef LIT_SSAO
		litArgs_ao *= texture2DLod(ssaoTexture, gl_FragCoord.xy * ssaoTextureSizeInv, 0.0).r;
	#endif
	#ifdef LIT_NEEDS_NORMAL
		#ifdef LIT_SPECULAR
			getReflDir(litArgs_worldNormal, dViewDirW, litArgs_gloss, dTBN);
		#endif
		#ifdef LIT_CLEARCOAT
			ccReflDirW = normalize(-reflect(dViewDirW, litArgs_clearcoat_worldNormal));
		#endif
	#endif
	#if defined(LIT_SPECULAR_OR_REFLECTION) || defined(LIT_REFRACTION)
		#ifdef LIT_METALNESS
			float f0 = 1.0 / litArgs_ior;
			f0 = (f0 - 1.0) / (f0 + 1.0);
			f0 *= f0;
			#ifdef LIT_SPECULARITY_FACTOR
				litArgs_specularity = getSpecularModulate(litArgs_specularity, litArgs_albedo, litArgs_metalness, f0, litArgs_specularityFactor);
			#else
				litArgs_specularity = getSpecularModulate(litArgs_specularity, litArgs_albedo, litArgs_metalness, f0, 1.0);
			#endif
			litArgs_albedo = getAlbedoModulate(litArgs_albedo, litArgs_metalness);
		#endif
		#ifdef LIT_IRIDESCENCE
			vec3 iridescenceFresnel = getIridescence(saturate(dot(dViewDirW, litArgs_worldNormal)), litArgs_specularity, litArgs_iridescence_thickness);
		#endif
	#endif
	#ifdef LIT_ADD_AMBIENT
		addAmbient(litArgs_worldNormal);
		#ifdef LIT_SPECULAR
			dDiffuseLight = dDiffuseLight * (1.0 - litArgs_specularity);
		#endif
		#ifdef LIT_SEPARATE_AMBIENT
			vec3 dAmbientLight = dDiffuseLight;
			dDiffuseLight = vec3(0);
		#endif
	#endif
	#ifndef LIT_OLD_AMBIENT
		dDiffuseLight *= litArgs_ambient;
	#endif
	#ifdef LIT_AO
		#ifndef LIT_OCCLUDE_DIRECT
			occludeDiffuse(litArgs_ao);
		#endif
	#endif
	#ifdef LIT_LIGHTMAP
		addLightMap(
			litArgs_lightmap, 
			litArgs_lightmapDir, 
			litArgs_worldNormal, 
			dViewDirW, 
			dReflDirW, 
			litArgs_gloss, 
			litArgs_specularity, 
			dVertexNormalW,
			dTBN
		#if defined(LIT_IRIDESCENCE)
			, iridescenceFresnel,
			litArgs_iridescence_intensity
		#endif
		);
	#endif
	#ifdef LIT_LIGHTING || LIT_REFLECTIONS
		#ifdef LIT_REFLECTIONS
			#ifdef LIT_CLEARCOAT
				addReflectionCC(ccReflDirW, litArgs_clearcoat_gloss);
			
				#ifdef LIT_SPECULAR_FRESNEL
					ccFresnel = getFresnelCC(dot(dViewDirW, litArgs_clearcoat_worldNormal));
					ccReflection *= ccFresnel;
				#else
					ccFresnel = 0.0;
				#endif
			#endif
			#ifdef LIT_SPECULARITY_FACTOR
				ccReflection *= litArgs_specularityFactor;
			#endif
			#ifdef LIT_SHEEN
				addReflectionSheen(litArgs_worldNormal, dViewDirW, litArgs_sheen_gloss);
			#endif
			addReflection(dReflDirW, litArgs_gloss);
			#ifdef LIT_FRESNEL_MODEL
				dReflection.rgb *= getFresnel(
					dot(dViewDirW, litArgs_worldNormal), 
					litArgs_gloss, 
					litArgs_specularity
				#if defined(LIT_IRIDESCENCE)
					, iridescenceFresnel,
					litArgs_iridescence_intensity
				#endif
					);
			#else
				dReflection.rgb *= litArgs_specularity;
			#endif
		#endif
		#ifdef AREA_LIGHTS
			dSpecularLight *= litArgs_specularity;
			#ifdef LIT_SPECULAR
				calcLTCLightValues(litArgs_gloss, litArgs_worldNormal, dViewDirW, litArgs_specularity, litArgs_clearcoat_gloss, litArgs_clearcoat_worldNormal, litArgs_clearcoat_specularity);
			#endif
		#endif
		
		#ifdef LIGHT_COUNT > 0
			#include "lightEvaluationPS, LIGHT_COUNT"
		#endif
		#ifdef LIT_CLUSTERED_LIGHTS
			addClusteredLights(litArgs_worldNormal, dViewDirW, dReflDirW,
				#if defined(LIT_CLEARCOAT)
						ccReflDirW,
				#endif
						litArgs_gloss, litArgs_specularity, dVertexNormalW, dTBN, 
				#if defined(LIT_IRIDESCENCE)
						iridescenceFresnel,
				#endif
						litArgs_clearcoat_worldNormal, litArgs_clearcoat_gloss, litArgs_sheen_gloss, litArgs_iridescence_intensity
			);
		#endif
		#ifdef AREA_LIGHTS
			#ifdef LIT_CLEARCOAT
				litArgs_clearcoat_specularity = 1.0;
			#endif
			#ifdef LIT_SPECULAR
				litArgs_specularity = vec3(1);
			#endif
		#endif
	#endif
	#ifdef LIT_REFRACTION
		addRefraction(
			litArgs_worldNormal,
			dViewDirW,
			litArgs_thickness,
			litArgs_gloss,
			litArgs_specularity,
			litArgs_albedo,
			litArgs_transmission,
			litArgs_ior,
			litArgs_dispersion
			#if defined(LIT_IRIDESCENCE)
				, iridescenceFresnel,
				litArgs_iridescence_intensity
			#endif
		);
	#endif
	#ifdef LIT_AO
		#ifdef LIT_OCCLUDE_DIRECT
			occludeDiffuse(litArgs_ao);
		#endif
		#if LIT_OCCLUDE_SPECULAR != NONE
			occludeSpecular(litArgs_gloss, litArgs_ao, litArgs_worldNormal, dViewDirW);
		#endif
	#endif
	#if !defined(LIT_OPACITY_FADES_SPECULAR)
		#if LIT_BLEND_TYPE == NORMAL || LIT_BLEND_TYPE == PREMULTIPLIED
			float specLum = dot((dSpecularLight + dReflection.rgb * dReflection.a), vec3( 0.2126, 0.7152, 0.0722 ));
			#ifdef LIT_CLEARCOAT
				specLum += dot(ccSpecularLight * litArgs_clearcoat_specularity + ccReflection * litArgs_clearcoat_specularity, vec3( 0.2126, 0.7152, 0.0722 ));
			#endif
			litArgs_opacity = clamp(litArgs_opacity + gammaCorrectInput(specLum), 0.0, 1.0);
		#endif
		litArgs_opacity *= material_alphaFade;
	#endif
	#ifdef LIT_LIGHTMAP_BAKING
		#ifdef LIT_LIGHTMAP_BAKING_COLOR
			#include "bakeLmEndPS"
		#endif
		#ifdef LIT_LIGHTMAP_BAKING_DIR
			#include "bakeDirLmEndPS"
		#endif
	#else
		#include "endPS"
		#include "outputAlphaPS"
	#endif
	#ifdef LIT_MSDF
		gl_FragColor = applyMsdf(gl_FragColor);
	#endif
	#include "outputPS"
	#include "debugOutputPS"
	#ifdef LIT_SHADOW_CATCHER
		gl_FragColor.rgb = vec3(dShadowCatcher);
	#endif
	#include "outlineOutputPS"
}
`;var JE=`
vec3 sReflection;
vec3 dVertexNormalW;
vec3 dTangentW;
vec3 dBinormalW;
vec3 dViewDirW;
vec3 dReflDirW;
vec3 ccReflDirW;
vec3 dLightDirNormW;
float dAtten;
mat3 dTBN;
vec4 dReflection;
vec3 dDiffuseLight;
vec3 dSpecularLight;
float ccFresnel;
vec3 ccReflection;
vec3 ccSpecularLight;
float ccSpecularityNoFres;
vec3 sSpecularLight;
#ifdef LIT_DISPERSION
	uniform float material_dispersion;
#endif
#ifndef LIT_OPACITY_FADES_SPECULAR
	uniform float material_alphaFade;
#endif
#ifdef LIT_SSAO
	uniform sampler2D ssaoTexture;
	uniform vec2 ssaoTextureSizeInv;
#endif
#ifdef LIT_SHADOW_CATCHER
	float dShadowCatcher = 1.0;
#endif
#if LIGHT_COUNT > 0
	#include "lightDeclarationPS, LIGHT_COUNT"
#endif
#ifdef LIT_SPECULAR
	#if LIT_FRESNEL_MODEL == NONE && !defined(LIT_REFLECTIONS) && !defined(LIT_DIFFUSE_MAP) 
		#define LIT_OLD_AMBIENT
	#endif
#endif
#ifdef STD_LIGHTMAP_DIR
	uniform float bakeDir;
#endif
#ifdef LIT_LIGHTMAP_BAKING_ADD_AMBIENT
	uniform float ambientBakeOcclusionContrast;
	uniform float ambientBakeOcclusionBrightness;
#endif
`;var ey=`
#include "sceneTexturesPS"
void main(void) {
	#include "litUserMainStartPS"
	dReflection = vec4(0);
	#ifdef LIT_CLEARCOAT
		ccSpecularLight = vec3(0);
		ccReflection = vec3(0);
	#endif
	#if LIT_NONE_SLICE_MODE == SLICED
		#include "startNineSlicedPS"
	#elif LIT_NONE_SLICE_MODE == TILED
		#include "startNineSlicedTiledPS"
	#endif
	#ifdef LIT_NEEDS_NORMAL
		#ifdef FLAT_SHADING
			dVertexNormalW = getFlatNormal(vPositionW);
		#else
			dVertexNormalW = normalize(vNormalW);
		#endif
		#ifdef LIT_TANGENTS
			#if defined(LIT_HEIGHTS) || defined(LIT_USE_NORMALS) || defined(LIT_USE_CLEARCOAT_NORMALS) || defined(LIT_GGX_SPECULAR)
				dTangentW = vTangentW;
				dBinormalW = vBinormalW;
			#endif
		#endif
		getViewDir();
		#ifdef LIT_TBN
			getTBN(dTangentW, dBinormalW, dVertexNormalW);
		#endif
		#ifdef LIT_TWO_SIDED_LIGHTING
			handleTwoSidedLighting();
		#endif
	#endif
	evaluateFrontend();
	#include "debugProcessFrontendPS"
	evaluateBackend();
	#ifdef SCENE_TEXTURE_DEPTH
		writeSceneTextureDepth(vLinearDepth, 1.0);
	#endif
	#include "litUserMainEndPS"
}
`;var ty=`
#ifdef LIT_NEEDS_NORMAL
	#include "cubeMapRotatePS"
	#include "cubeMapProjectPS"
	#include "envProcPS"
#endif
#if defined(LIT_SPECULAR_OR_REFLECTION) || defined(LIT_REFRACTION)
	#ifdef LIT_METALNESS
		#include "metalnessModulatePS"
	#endif
	#ifdef LIT_IRIDESCENCE
		#include "iridescenceDiffractionPS"
	#endif
#endif
#if defined(LIT_SPECULAR_OR_REFLECTION) || defined(LIT_REFRACTION)
	#if LIT_FRESNEL_MODEL == SCHLICK
		#include "fresnelSchlickPS"
	#endif
#endif
#ifdef LIT_AO
	#include "aoDiffuseOccPS"
	#include "aoSpecOccPS"
#endif
#if LIT_REFLECTION_SOURCE == ENVATLASHQ
	#include "envAtlasPS"
	#include "reflectionEnvHQPS"
#elif LIT_REFLECTION_SOURCE == ENVATLAS
	#include "envAtlasPS"
	#include "reflectionEnvPS"
#elif LIT_REFLECTION_SOURCE == CUBEMAP
	#include "reflectionCubePS"
#elif LIT_REFLECTION_SOURCE == SPHEREMAP
	#include "reflectionSpherePS"
#endif
#ifdef LIT_REFLECTIONS
	#ifdef LIT_CLEARCOAT
		#include "reflectionCCPS"
	#endif
	#ifdef LIT_SHEEN
		#include "reflectionSheenPS"
	#endif
#endif
#ifdef LIT_REFRACTION
	#if defined(LIT_DYNAMIC_REFRACTION)
		#include "refractionDynamicPS"
	#elif LIT_REFLECTION_SOURCE != NONE
		#include "refractionCubePS"
	#endif
#endif
#ifdef LIT_SHEEN
	#include "lightSheenPS"
#endif
#ifdef LIT_SPECULAR
	#ifdef LIT_LIGHTING
		#ifdef LIT_GGX_SPECULAR
			#ifdef LIT_ANISOTROPY
				#include "lightSpecularAnisoGGXPS"
			#else
				#include "lightSpecularGGXPS"
			#endif
		#else
			#include "lightSpecularBlinnPS"
		#endif
	#endif
#endif
#include "combinePS"
#ifdef LIT_LIGHTMAP
	#include "lightmapAddPS"
#endif
#ifdef LIT_ADD_AMBIENT
	#include "ambientPS"
#endif
#ifdef LIT_MSDF
	#include "msdfPS"
#endif
#ifdef LIT_NEEDS_NORMAL
	#include "viewDirPS"
	#ifdef LIT_SPECULAR
		#ifdef LIT_ANISOTROPY
			#include "reflDirAnisoPS"
		#else
			#include "reflDirPS"
		#endif
	#endif
#endif
#include "lightingPS"
`;var sy=`
#include "basePS"
#include "sphericalPS"
#include "decodePS"
#include "gammaPS"
#include "tonemappingPS"
#include "fogPS"
#if LIT_NONE_SLICE_MODE == SLICED
	#include "baseNineSlicedPS"
#elif LIT_NONE_SLICE_MODE == TILED
	#include "baseNineSlicedTiledPS"
#endif
#ifdef FLAT_SHADING
	#include "flatNormalPS"
#endif
#ifdef LIT_TBN
	#include "TBNPS"
#endif
#if defined(LIT_NEEDS_NORMAL) && defined(LIT_TWO_SIDED_LIGHTING)
	#include "twoSidedLightingPS"
#endif
`;var ry=`
#include "varyingsPS"
#include "litUserDeclarationPS"
#include "frontendDeclPS"
#include "outlineDeclarationPS"
#if defined(PICK_PASS) || defined(PREPASS_PASS)
	#include "frontendCodePS"
	#include "litUserCodePS"
	#include "litOtherMainPS"
#elif defined(SHADOW_PASS)
	#include "frontendCodePS"
	#include "litUserCodePS"
	#include "litShadowMainPS"
#else
	#include "litForwardDeclarationPS"
	#include "litForwardPreCodePS"
	#include "frontendCodePS"
	#include "litForwardPostCodePS"
	#include "litForwardBackendPS"
	#include "litUserCodePS"
	#include "litForwardMainPS"
#endif
`;var iy=`
#include "varyingsVS"
#include  "litUserDeclarationVS"
#ifdef VERTEX_COLOR
	attribute vec4 vertex_color;
#endif
#ifdef NINESLICED
	varying vec2 vMask;
	varying vec2 vTiledUv;
	uniform mediump vec4 innerOffset;
	uniform mediump vec2 outerScale;
	uniform mediump vec4 atlasRect;
#endif
vec3 dPositionW;
mat4 dModelMatrix;
#include "transformCoreVS"
#ifdef UV0
	attribute vec2 vertex_texCoord0;
	#include "uv0VS"
#endif
#ifdef UV1
	attribute vec2 vertex_texCoord1;
	#include "uv1VS"
#endif
#include "uvSetAttributeVS, UV_SET_COUNT"
#ifdef LINEAR_DEPTH
	#ifndef VIEWMATRIX
	#define VIEWMATRIX
		uniform mat4 matrix_view;
	#endif
#endif
#include "transformVS"
#ifdef NORMALS
	#include "normalCoreVS"
	#include "normalVS"
#endif
#ifdef TANGENTS
	attribute vec4 vertex_tangent;
#endif
#include "uvTransformUniformsPS, UV_TRANSFORMS_COUNT"
#ifdef MSDF
	#include "msdfVS"
#endif
#include  "litUserCodeVS"
#ifdef VERTEX_COLOR
	vec3 decodeGamma(vec3 raw) {
		return pow(raw, vec3(2.2));
	}
	vec4 gammaCorrectInput(vec4 color) {
		return vec4(decodeGamma(color.xyz), color.w);
	}
#endif
void main(void) {
	#include "litUserMainStartVS"
	gl_PointSize = 1.0;
	gl_Position = getPosition();
	vPositionW = getWorldPosition();
	#ifdef NORMALS
		vNormalW = getNormal();
	#endif
	#ifdef TANGENTS
		vTangentW = normalize(dNormalMatrix * vertex_tangent.xyz);
		vBinormalW = cross(vNormalW, vTangentW) * vertex_tangent.w;
	#elif defined(GGX_SPECULAR)
		vObjectSpaceUpW = normalize(dNormalMatrix * vec3(0, 1, 0));
	#endif
	#ifdef UV0
		vec2 uv0 = getUv0();
		#ifdef UV0_UNMODIFIED
			vUv0 = uv0;
		#endif
	#endif
	#ifdef UV1
		vec2 uv1 = getUv1();
		#ifdef UV1_UNMODIFIED
			vUv1 = uv1;
		#endif
	#endif
	#include "uvSetVS, UV_SET_COUNT"
	#include "uvSetVaryingVS, UV_VARYING_SET_COUNT"
	#include "uvTransformVS, UV_TRANSFORMS_COUNT"
	#ifdef VERTEX_COLOR
		#ifdef STD_VERTEX_COLOR_GAMMA
			vVertexColor = gammaCorrectInput(vertex_color);
		#else
			vVertexColor = vertex_color;
		#endif
	#endif
	#ifdef LINEAR_DEPTH
		vLinearDepth = -(matrix_view * vec4(vPositionW, 1.0)).z;
	#endif
	#ifdef LIT_DYNAMIC_REFRACTION
		vModelScale = vec3(length(dModelMatrix[0].xyz), length(dModelMatrix[1].xyz), length(dModelMatrix[2].xyz));
	#endif
	#ifdef MSDF
		unpackMsdfParams();
	#endif
	#include "litUserMainEndVS"
}
`;var ay=`
#ifdef PICK_PASS
	#include "pickPS"
#endif
#ifdef PREPASS_PASS
	#include "floatAsUintPS"
#endif
void main(void) {
	#include "litUserMainStartPS"
	evaluateFrontend();
	#ifdef PICK_PASS
		pcFragColor0 = getPickOutput();
		#ifdef DEPTH_PICK_PASS
			pcFragColor1 = getPickDepth();
		#endif
	#endif
	#ifdef PREPASS_PASS
		gl_FragColor = float2vec4(vLinearDepth);
	#endif
	#include "litUserMainEndPS"
}
`;var oy=`
vec3 litArgs_albedo;
float litArgs_opacity;
vec3 litArgs_emission;
vec3 litArgs_worldNormal;
float litArgs_ao;
vec3 litArgs_ambient = vec3(1.0);
vec3 litArgs_lightmap;
vec3 litArgs_lightmapDir;
float litArgs_metalness;
vec3 litArgs_specularity;
float litArgs_specularityFactor;
float litArgs_gloss;
float litArgs_sheen_gloss;
vec3 litArgs_sheen_specularity;
float litArgs_transmission;
float litArgs_thickness;
float litArgs_ior;
float litArgs_dispersion;
float litArgs_iridescence_intensity;
float litArgs_iridescence_thickness;
vec3 litArgs_clearcoat_worldNormal;
float litArgs_clearcoat_specularity;
float litArgs_clearcoat_gloss;
`;var ny=`
	uniform float textureBias;
	#if LIT_NONE_SLICE_MODE == TILED
		#define {STD_TEXTURE_BIAS} (-1000.0)
	#else
		#define {STD_TEXTURE_BIAS} textureBias
	#endif
	#include "litShaderArgsPS"
`;var ly=`
#if LIGHT_TYPE != DIRECTIONAL
	uniform vec3 view_position;
	uniform float light_radius;
#endif
#if SHADOW_TYPE == PCSS_32F
	#include "linearizeDepthPS"
#endif
void main(void) {
	#include "litUserMainStartPS"
	evaluateFrontend();
	#ifdef PERSPECTIVE_DEPTH
		float depth = gl_FragCoord.z;
		#if SHADOW_TYPE == PCSS_32F
			#if LIGHT_TYPE != DIRECTIONAL
				depth = linearizeDepthWithParams(depth, camera_params);
			#endif
		#endif
	#else
		float depth = min(distance(view_position, vPositionW) / light_radius, 0.99999);
		#define MODIFIED_DEPTH
	#endif
	#if SHADOW_TYPE == VSM_16F || SHADOW_TYPE == VSM_32F
		if (!(depth >= 0.0 && depth <= 1.0)) discard;
		#if SHADOW_TYPE == VSM_32F
			float exponent = 15.0;
		#else
			float exponent = 5.54;
		#endif
		depth = 2.0 * depth - 1.0;
		depth =  exp(exponent * depth);
		gl_FragColor = vec4(depth, depth*depth, 1.0, 1.0);
	#else
		#if SHADOW_TYPE == PCSS_32F
			gl_FragColor.r = depth;
		#else
			#ifdef MODIFIED_DEPTH
				gl_FragDepth = depth;
			#endif
			gl_FragColor = vec4(1.0);
		#endif
	#endif
	#include "litUserMainEndPS"
}
`;var cy=`
mat3 transposeMat3( const in mat3 m ) {
	mat3 tmp;
	tmp[ 0 ] = vec3( m[ 0 ].x, m[ 1 ].x, m[ 2 ].x );
	tmp[ 1 ] = vec3( m[ 0 ].y, m[ 1 ].y, m[ 2 ].y );
	tmp[ 2 ] = vec3( m[ 0 ].z, m[ 1 ].z, m[ 2 ].z );
	return tmp;
}
vec2 LTC_Uv( const in vec3 N, const in vec3 V, const in float roughness ) {
	const float LUT_SIZE = 64.0;
	const float LUT_SCALE = ( LUT_SIZE - 1.0 ) / LUT_SIZE;
	const float LUT_BIAS = 0.5 / LUT_SIZE;
	float dotNV = saturate( dot( N, V ) );
	vec2 uv = vec2( roughness, sqrt( 1.0 - dotNV ) );
	uv = uv * LUT_SCALE + LUT_BIAS;
	return uv;
}
float LTC_ClippedSphereFormFactor( const in vec3 f ) {
	float l = length( f );
	return max( ( l * l + f.z ) / ( l + 1.0 ), 0.0 );
}
vec3 LTC_EdgeVectorFormFactor( const in vec3 v1, const in vec3 v2 ) {
	float x = dot( v1, v2 );
	float y = abs( x );
	float a = 0.8543985 + ( 0.4965155 + 0.0145206 * y ) * y;
	float b = 3.4175940 + ( 4.1616724 + y ) * y;
	float v = a / b;
	float theta_sintheta = ( x > 0.0 ) ? v : 0.5 * inversesqrt( max( 1.0 - x * x, 1e-7 ) ) - v;
	return cross( v1, v2 ) * theta_sintheta;
}
struct Coords {
	vec3 coord0;
	vec3 coord1;
	vec3 coord2;
	vec3 coord3;
};
float LTC_EvaluateRect( const in vec3 N, const in vec3 V, const in vec3 P, const in mat3 mInv, const in Coords rectCoords) {
	vec3 v1 = rectCoords.coord1 - rectCoords.coord0;
	vec3 v2 = rectCoords.coord3 - rectCoords.coord0;
	
	vec3 lightNormal = cross( v1, v2 );
	float factor = sign(-dot( lightNormal, P - rectCoords.coord0 ));
	vec3 T1, T2;
	T1 = normalize( V - N * dot( V, N ) );
	T2 =  factor * cross( N, T1 );
	mat3 mat = mInv * transposeMat3( mat3( T1, T2, N ) );
	vec3 coords[ 4 ];
	coords[ 0 ] = mat * ( rectCoords.coord0 - P );
	coords[ 1 ] = mat * ( rectCoords.coord1 - P );
	coords[ 2 ] = mat * ( rectCoords.coord2 - P );
	coords[ 3 ] = mat * ( rectCoords.coord3 - P );
	coords[ 0 ] = normalize( coords[ 0 ] );
	coords[ 1 ] = normalize( coords[ 1 ] );
	coords[ 2 ] = normalize( coords[ 2 ] );
	coords[ 3 ] = normalize( coords[ 3 ] );
	vec3 vectorFormFactor = vec3( 0.0 );
	vectorFormFactor += LTC_EdgeVectorFormFactor( coords[ 0 ], coords[ 1 ] );
	vectorFormFactor += LTC_EdgeVectorFormFactor( coords[ 1 ], coords[ 2 ] );
	vectorFormFactor += LTC_EdgeVectorFormFactor( coords[ 2 ], coords[ 3 ] );
	vectorFormFactor += LTC_EdgeVectorFormFactor( coords[ 3 ], coords[ 0 ] );
	float result = LTC_ClippedSphereFormFactor( vectorFormFactor );
	return result;
}
Coords dLTCCoords;
Coords getLTCLightCoords(vec3 lightPos, vec3 halfWidth, vec3 halfHeight){
	Coords coords;
	coords.coord0 = lightPos + halfWidth - halfHeight;
	coords.coord1 = lightPos - halfWidth - halfHeight;
	coords.coord2 = lightPos - halfWidth + halfHeight;
	coords.coord3 = lightPos + halfWidth + halfHeight;
	return coords;
}
float dSphereRadius;
Coords getSphereLightCoords(vec3 lightPos, vec3 halfWidth, vec3 halfHeight){
	dSphereRadius = max(length(halfWidth), length(halfHeight));
	vec3 f = reflect(normalize(lightPos - view_position), vNormalW);
	vec3 w = normalize(cross(f, halfHeight));
	vec3 h = normalize(cross(f, w));
	return getLTCLightCoords(lightPos, w * dSphereRadius, h * dSphereRadius);
}
vec2 dLTCUV;
#ifdef LIT_CLEARCOAT
	vec2 ccLTCUV;
#endif
vec2 getLTCLightUV(float gloss, vec3 worldNormal, vec3 viewDir)
{
	float roughness = max((1.0 - gloss) * (1.0 - gloss), 0.001);
	return LTC_Uv( worldNormal, viewDir, roughness );
}
vec3 dLTCSpecFres;
#ifdef LIT_CLEARCOAT
	vec3 ccLTCSpecFres;
#endif
vec3 getLTCLightSpecFres(vec2 uv, vec3 specularity)
{
	vec4 t2 = texture2DLod(areaLightsLutTex2, uv, 0.0);
	return specularity * t2.x + ( vec3( 1.0 ) - specularity) * t2.y;
}
void calcLTCLightValues(float gloss, vec3 worldNormal, vec3 viewDir, vec3 specularity, float clearcoatGloss, vec3 clearcoatWorldNormal, float clearcoatSpecularity)
{
	dLTCUV = getLTCLightUV(gloss, worldNormal, viewDir);
	dLTCSpecFres = getLTCLightSpecFres(dLTCUV, specularity); 
#ifdef LIT_CLEARCOAT
	ccLTCUV = getLTCLightUV(clearcoatGloss, clearcoatWorldNormal, viewDir);
	ccLTCSpecFres = getLTCLightSpecFres(ccLTCUV, vec3(clearcoatSpecularity));
#endif
}
void calcRectLightValues(vec3 lightPos, vec3 halfWidth, vec3 halfHeight) {
	dLTCCoords = getLTCLightCoords(lightPos, halfWidth, halfHeight);
}
void calcDiskLightValues(vec3 lightPos, vec3 halfWidth, vec3 halfHeight) {
	calcRectLightValues(lightPos, halfWidth, halfHeight);
}
void calcSphereLightValues(vec3 lightPos, vec3 halfWidth, vec3 halfHeight) {
	dLTCCoords = getSphereLightCoords(lightPos, halfWidth, halfHeight);
}
vec3 SolveCubic(vec4 Coefficient)
{
	float pi = 3.14159;
	Coefficient.xyz /= Coefficient.w;
	Coefficient.yz /= 3.0;
	float A = Coefficient.w;
	float B = Coefficient.z;
	float C = Coefficient.y;
	float D = Coefficient.x;
	vec3 Delta = vec3(
		-Coefficient.z * Coefficient.z + Coefficient.y,
		-Coefficient.y * Coefficient.z + Coefficient.x,
		dot(vec2(Coefficient.z, -Coefficient.y), Coefficient.xy)
	);
	float Discriminant = dot(vec2(4.0 * Delta.x, -Delta.y), Delta.zy);
	vec2 xlc, xsc;
	{
		float A_a = 1.0;
		float C_a = Delta.x;
		float D_a = -2.0 * B * Delta.x + Delta.y;
		float Theta = atan(sqrt(Discriminant), -D_a) / 3.0;
		float x_1a = 2.0 * sqrt(-C_a) * cos(Theta);
		float x_3a = 2.0 * sqrt(-C_a) * cos(Theta + (2.0 / 3.0) * pi);
		float xl;
		if ((x_1a + x_3a) > 2.0 * B)
			xl = x_1a;
		else
			xl = x_3a;
		xlc = vec2(xl - B, A);
	}
	{
		float A_d = D;
		float C_d = Delta.z;
		float D_d = -D * Delta.y + 2.0 * C * Delta.z;
		float Theta = atan(D * sqrt(Discriminant), -D_d) / 3.0;
		float x_1d = 2.0 * sqrt(-C_d) * cos(Theta);
		float x_3d = 2.0 * sqrt(-C_d) * cos(Theta + (2.0 / 3.0) * pi);
		float xs;
		if (x_1d + x_3d < 2.0 * C)
			xs = x_1d;
		else
			xs = x_3d;
		xsc = vec2(-D, xs + C);
	}
	float E =  xlc.y * xsc.y;
	float F = -xlc.x * xsc.y - xlc.y * xsc.x;
	float G =  xlc.x * xsc.x;
	vec2 xmc = vec2(C * F - B * G, -B * F + C * E);
	vec3 Root = vec3(xsc.x / xsc.y, xmc.x / xmc.y, xlc.x / xlc.y);
	if (Root.x < Root.y && Root.x < Root.z)
		Root.xyz = Root.yxz;
	else if (Root.z < Root.x && Root.z < Root.y)
		Root.xyz = Root.xzy;
	return Root;
}
float LTC_EvaluateDisk(vec3 N, vec3 V, vec3 P, mat3 Minv, Coords points)
{
	vec3 T1 = normalize(V - N * dot(V, N));
	vec3 T2 = cross(N, T1);
	mat3 R = transposeMat3( mat3( T1, T2, N ) );
	vec3 L_[ 3 ];
	L_[ 0 ] = R * ( points.coord0 - P );
	L_[ 1 ] = R * ( points.coord1 - P );
	L_[ 2 ] = R * ( points.coord2 - P );
	vec3 C  = 0.5 * (L_[0] + L_[2]);
	vec3 V1 = 0.5 * (L_[1] - L_[2]);
	vec3 V2 = 0.5 * (L_[1] - L_[0]);
	C  = Minv * C;
	V1 = Minv * V1;
	V2 = Minv * V2;
	float a, b;
	float d11 = dot(V1, V1);
	float d22 = dot(V2, V2);
	float d12 = dot(V1, V2);
	if (abs(d12) / sqrt(d11 * d22) > 0.0001)
	{
		float tr = d11 + d22;
		float det = -d12 * d12 + d11 * d22;
		det = sqrt(det);
		float u = 0.5 * sqrt(tr - 2.0 * det);
		float v = 0.5 * sqrt(tr + 2.0 * det);
		float e_max = (u + v) * (u + v);
		float e_min = (u - v) * (u - v);
		vec3 V1_, V2_;
		if (d11 > d22)
		{
			V1_ = d12 * V1 + (e_max - d11) * V2;
			V2_ = d12 * V1 + (e_min - d11) * V2;
		}
		else
		{
			V1_ = d12*V2 + (e_max - d22)*V1;
			V2_ = d12*V2 + (e_min - d22)*V1;
		}
		a = 1.0 / e_max;
		b = 1.0 / e_min;
		V1 = normalize(V1_);
		V2 = normalize(V2_);
	}
	else
	{
		a = 1.0 / dot(V1, V1);
		b = 1.0 / dot(V2, V2);
		V1 *= sqrt(a);
		V2 *= sqrt(b);
	}
	vec3 V3 = normalize(cross(V1, V2));
	if (dot(C, V3) < 0.0)
		V3 *= -1.0;
	float L  = dot(V3, C);
	float x0 = dot(V1, C) / L;
	float y0 = dot(V2, C) / L;
	float E1 = inversesqrt(a);
	float E2 = inversesqrt(b);
	a *= L * L;
	b *= L * L;
	float c0 = a * b;
	float c1 = a * b * (1.0 + x0 * x0 + y0 * y0) - a - b;
	float c2 = 1.0 - a * (1.0 + x0 * x0) - b * (1.0 + y0 * y0);
	float c3 = 1.0;
	vec3 roots = SolveCubic(vec4(c0, c1, c2, c3));
	float e1 = roots.x;
	float e2 = roots.y;
	float e3 = roots.z;
	vec3 avgDir = vec3(a * x0 / (a - e2), b * y0 / (b - e2), 1.0);
	mat3 rotate = mat3(V1, V2, V3);
	avgDir = rotate * avgDir;
	avgDir = normalize(avgDir);
	float L1 = sqrt(-e2 / e3);
	float L2 = sqrt(-e2 / e1);
	float formFactor = max(0.0, L1 * L2 * inversesqrt((1.0 + L1 * L1) * (1.0 + L2 * L2)));
	
	const float LUT_SIZE = 64.0;
	const float LUT_SCALE = ( LUT_SIZE - 1.0 ) / LUT_SIZE;
	const float LUT_BIAS = 0.5 / LUT_SIZE;
	vec2 uv = vec2(avgDir.z * 0.5 + 0.5, formFactor);
	uv = uv*LUT_SCALE + LUT_BIAS;
	float scale = texture2DLod(areaLightsLutTex2, uv, 0.0).w;
	return formFactor*scale;
}
float FixNan(float value) {
	#ifdef WEBGPU
		return value != value ? 0.0 : value;
	#else
		return isnan(value) ? 0.0 : value;
	#endif
}
float getRectLightDiffuse(vec3 worldNormal, vec3 viewDir, vec3 lightDir, vec3 lightDirNorm) {
	return LTC_EvaluateRect( worldNormal, viewDir, vPositionW, mat3( 1.0 ), dLTCCoords );
}
float getDiskLightDiffuse(vec3 worldNormal, vec3 viewDir, vec3 lightDir, vec3 lightDirNorm) {
	return FixNan(LTC_EvaluateDisk( worldNormal, viewDir, vPositionW, mat3( 1.0 ), dLTCCoords ));
}
float getSphereLightDiffuse(vec3 worldNormal, vec3 viewDir, vec3 lightDir, vec3 lightDirNorm) {
	float falloff = dSphereRadius / (dot(lightDir, lightDir) + dSphereRadius);
	return FixNan(getLightDiffuse(worldNormal, viewDir, lightDirNorm) * falloff);
}
mat3 getLTCLightInvMat(vec2 uv)
{
	vec4 t1 = texture2DLod(areaLightsLutTex1, uv, 0.0);
	return mat3(
		vec3( t1.x, 0, t1.y ),
		vec3(	0, 1,	0 ),
		vec3( t1.z, 0, t1.w )
	);
}
float calcRectLightSpecular(vec3 worldNormal, vec3 viewDir, vec2 uv) {
	mat3 mInv = getLTCLightInvMat(uv);
	return LTC_EvaluateRect( worldNormal, viewDir, vPositionW, mInv, dLTCCoords );
}
float getRectLightSpecular(vec3 worldNormal, vec3 viewDir) {
	return calcRectLightSpecular(worldNormal, viewDir, dLTCUV);
}
float calcDiskLightSpecular(vec3 worldNormal, vec3 viewDir, vec2 uv) {
	mat3 mInv = getLTCLightInvMat(uv);
	return LTC_EvaluateDisk( worldNormal, viewDir, vPositionW, mInv, dLTCCoords );
}
float getDiskLightSpecular(vec3 worldNormal, vec3 viewDir) {
	return calcDiskLightSpecular(worldNormal, viewDir, dLTCUV);
}
float getSphereLightSpecular(vec3 worldNormal, vec3 viewDir) {
	return calcDiskLightSpecular(worldNormal, viewDir, dLTCUV);
}
`;var hy=`
#ifdef STD_METALNESS_CONSTANT
uniform float material_metalness;
#endif
void getMetalness() {
	float metalness = 1.0;
	#ifdef STD_METALNESS_CONSTANT
	metalness *= material_metalness;
	#endif
	#ifdef STD_METALNESS_TEXTURE
	metalness *= texture2DBias({STD_METALNESS_TEXTURE_NAME}, {STD_METALNESS_TEXTURE_UV}, {STD_TEXTURE_BIAS}).{STD_METALNESS_TEXTURE_CHANNEL};
	#endif
	#ifdef STD_METALNESS_VERTEX
	metalness *= saturate(vVertexColor.{STD_METALNESS_VERTEX_CHANNEL});
	#endif
	dMetalness = metalness;
}
`;var dy=`
uniform sampler2D texture_msdfMap;
float median(float r, float g, float b) {
	return max(min(r, g), min(max(r, g), b));
}
uniform float font_sdfIntensity;
uniform float font_pxrange;
#ifndef LIT_MSDF_TEXT_ATTRIBUTE
	uniform vec4 outline_color;
	uniform float outline_thickness;
	uniform vec4 shadow_color;
	uniform vec2 shadow_offset;
#else
	varying vec4 outline_color;
	varying float outline_thickness;
	varying vec4 shadow_color;
	varying vec2 shadow_offset;
#endif
vec4 applyMsdf(vec4 color) {
	float srcAlpha = max(color.a, 0.0001);
	color.rgb = gammaCorrectInput(color.rgb / srcAlpha) * srcAlpha;
	vec3 tsample = texture2D(texture_msdfMap, vUv0).rgb;
	vec2 uvShdw = vUv0 - shadow_offset;
	vec3 ssample = texture2D(texture_msdfMap, uvShdw).rgb;
	float sigDist = median(tsample.r, tsample.g, tsample.b);
	float sigDistShdw = median(ssample.r, ssample.g, ssample.b);
	float edge = 0.5 - 0.5 * font_sdfIntensity;
	vec2 unitRange = vec2(font_pxrange) / vec2(textureSize(texture_msdfMap, 0));
	float screenPxRange = max(0.5 * dot(unitRange, 1.0 / max(fwidth(vUv0), vec2(1e-6))), 2.5);
	float inside = clamp(screenPxRange * (sigDist - edge) + 0.5, 0.0, 1.0);
	float outline = clamp(screenPxRange * (sigDist + outline_thickness - edge) + 0.5, 0.0, 1.0);
	float shadow = clamp(screenPxRange * (sigDistShdw + outline_thickness - edge) + 0.5, 0.0, 1.0);
	vec4 tcolor = (outline > inside) ? outline * vec4(outline_color.a * outline_color.rgb, outline_color.a) : vec4(0.0);
	tcolor = mix(tcolor, color, inside);
	vec4 scolor = (shadow > outline) ? shadow * vec4(shadow_color.a * shadow_color.rgb, shadow_color.a) : tcolor;
	tcolor = mix(scolor, tcolor, outline);
	tcolor.rgb = gammaCorrectOutput(tcolor.rgb / max(tcolor.a, 0.0001)) * tcolor.a;
	
	return tcolor;
}
`;var fy=`
vec3 getSpecularModulate(in vec3 specularity, in vec3 albedo, in float metalness, in float f0, in float specularityFactor) {
	vec3 dielectricF0 = f0 * specularity * specularityFactor;
	return mix(dielectricF0, albedo, metalness);
}
vec3 getAlbedoModulate(in vec3 albedo, in float metalness) {
	return albedo * (1.0 - metalness);
}
`;var uy=`
	varying vec2 uv0;
	uniform sampler2DArray morphTexture;
	uniform highp float morphFactor[{MORPH_TEXTURE_MAX_COUNT}];
	uniform highp uint morphIndex[{MORPH_TEXTURE_MAX_COUNT}];
	uniform int count;
	#ifdef MORPH_INT
		uniform vec3 aabbSize;
		uniform vec3 aabbMin;
	#endif
	void main (void) {
		highp vec3 color = vec3(0, 0, 0);
		ivec2 pixelCoords = ivec2(uv0 * vec2(textureSize(morphTexture, 0).xy));
		
		for (int i = 0; i < count; i++) {
			uint textureIndex = morphIndex[i];
			vec3 delta = texelFetch(morphTexture, ivec3(pixelCoords, int(textureIndex)), 0).xyz;
			color += morphFactor[i] * delta;
		}
		#ifdef MORPH_INT
			color = (color - aabbMin) / aabbSize * 65535.0;
			gl_FragColor = uvec4(color, 1u);
		#else
			gl_FragColor = vec4(color, 1.0);
		#endif
	}
`;var my=`
	attribute vec2 vertex_position;
	varying vec2 uv0;
	void main(void) {
		gl_Position = vec4(vertex_position, 0.5, 1.0);
		uv0 = vertex_position.xy * 0.5 + 0.5;
	}
`;var py=`
attribute vec3 vertex_outlineParameters;
attribute vec3 vertex_shadowParameters;
varying vec4 outline_color;
varying float outline_thickness;
varying vec4 shadow_color;
varying vec2 shadow_offset;
void unpackMsdfParams() {
	vec3 little = mod(vertex_outlineParameters, 256.);
	vec3 big = (vertex_outlineParameters - little) / 256.;
	outline_color.rb = little.xy / 255.;
	outline_color.ga = big.xy / 255.;
	outline_thickness = little.z / 255. * 0.2;
	little = mod(vertex_shadowParameters, 256.);
	big = (vertex_shadowParameters - little) / 256.;
	shadow_color.rb = little.xy / 255.;
	shadow_color.ga = big.xy / 255.;
	shadow_offset = (vec2(little.z, big.z) / 127. - 1.) * 0.005;
}
`;var _y=`
mat3 dNormalMatrix;
vec3 getNormal() {
	dNormalMatrix = getNormalMatrix(dModelMatrix);
	vec3 localNormal = getLocalNormal(vertex_normal);
	return normalize(dNormalMatrix * localNormal);
}
`;var gy=`
attribute vec3 vertex_normal;
#ifdef MORPHING_NORMAL
	#ifdef MORPHING_INT
		uniform highp usampler2D morphNormalTex;
	#else
		uniform highp sampler2D morphNormalTex;
	#endif
#endif
vec3 getLocalNormal(vec3 vertexNormal) {
	vec3 localNormal = vertex_normal;
	#ifdef MORPHING_NORMAL
		ivec2 morphUV = getTextureMorphCoords();
		#ifdef MORPHING_INT
			vec3 morphNormal = vec3(texelFetch(morphNormalTex, ivec2(morphUV), 0).xyz) / 65535.0 * 2.0 - 1.0;
		#else
			vec3 morphNormal = texelFetch(morphNormalTex, ivec2(morphUV), 0).xyz;
		#endif
		localNormal += morphNormal;
	#endif
	return localNormal;
}
#if defined(SKIN) || defined(BATCH) || defined(INSTANCING) || defined(SHADOW_PASS)
	mat3 getNormalMatrix(mat4 modelMatrix) {
		return mat3(modelMatrix[0].xyz, modelMatrix[1].xyz, modelMatrix[2].xyz);
	}
#else
	uniform mat3 matrix_normal;
	mat3 getNormalMatrix(mat4 modelMatrix) {
		return matrix_normal;
	}
#endif
`;var Sy=`
#ifdef STD_NORMAL_TEXTURE
	uniform float material_bumpiness;
#endif
#ifdef STD_NORMALDETAIL_TEXTURE
	uniform float material_normalDetailMapBumpiness;
	vec3 blendNormals(vec3 n1, vec3 n2) {
		n1 += vec3(0, 0, 1);
		n2 *= vec3(-1, -1, 1);
		return n1 * dot(n1, n2) / n1.z - n2;
	}
#endif
void getNormal() {
#ifdef STD_NORMAL_TEXTURE
	vec3 normalMap = {STD_NORMAL_TEXTURE_DECODE}(texture2DBias({STD_NORMAL_TEXTURE_NAME}, {STD_NORMAL_TEXTURE_UV}, {STD_TEXTURE_BIAS}));
	normalMap = mix(vec3(0.0, 0.0, 1.0), normalMap, material_bumpiness);
	#ifdef STD_NORMALDETAIL_TEXTURE
		vec3 normalDetailMap = {STD_NORMALDETAIL_TEXTURE_DECODE}(texture2DBias({STD_NORMALDETAIL_TEXTURE_NAME}, {STD_NORMALDETAIL_TEXTURE_UV}, {STD_TEXTURE_BIAS}));
		normalDetailMap = mix(vec3(0.0, 0.0, 1.0), normalDetailMap, material_normalDetailMapBumpiness);
		normalMap = blendNormals(normalMap, normalDetailMap);
	#endif
	dNormalW = normalize(dTBN * normalMap);
#else
	dNormalW = dVertexNormalW;
#endif
}
`;var Ty=`
#ifndef MESH_COLOR
	uniform float material_opacity;
#endif
uniform float material_alphaDitherScale;
void getOpacity() {
	#ifdef MESH_COLOR
		dAlpha = mesh_color.a;
	#else
		dAlpha = material_opacity;
	#endif
	#ifdef STD_OPACITY_TEXTURE
	dAlpha *= texture2DBias({STD_OPACITY_TEXTURE_NAME}, {STD_OPACITY_TEXTURE_UV}, {STD_TEXTURE_BIAS}).{STD_OPACITY_TEXTURE_CHANNEL};
	#endif
	#ifdef STD_OPACITY_VERTEX
	dAlpha *= clamp(vVertexColor.{STD_OPACITY_VERTEX_CHANNEL}, 0.0, 1.0);
	#endif
}
`;var Ey=`
#if STD_OPACITY_DITHER == BAYER2 || STD_OPACITY_DITHER == BAYER4 || STD_OPACITY_DITHER == BAYER8 || STD_OPACITY_DITHER == BAYER16
	#include "bayerPS"
#endif
uniform vec4 blueNoiseJitter;
#if STD_OPACITY_DITHER == BLUENOISE
	uniform sampler2D blueNoiseTex32;
#endif
void opacityDither(float alpha, float id) {
	if (alpha <= 0.0)
		discard;
	if (alpha >= 1.0)
		return;
	#if STD_OPACITY_DITHER == BAYER8
		float noise = bayer8(floor(mod(gl_FragCoord.xy + blueNoiseJitter.xy + id, 8.0))) / 64.0;
	#else
		#if STD_OPACITY_DITHER == BAYER2
			float noise = bayer2(floor(mod(gl_FragCoord.xy + blueNoiseJitter.xy + id, 2.0))) / 4.0;
		#endif
		#if STD_OPACITY_DITHER == BAYER4
			float noise = bayer4(floor(mod(gl_FragCoord.xy + blueNoiseJitter.xy + id, 4.0))) / 16.0;
		#endif
		#if STD_OPACITY_DITHER == BAYER16
			float noise = bayer16(floor(mod(gl_FragCoord.xy + blueNoiseJitter.xy + id, 16.0))) / 256.0;
		#endif
		#if STD_OPACITY_DITHER == BLUENOISE
			vec2 uv = fract(gl_FragCoord.xy / 32.0 + blueNoiseJitter.xy + id);
			float noise = texture2DLod(blueNoiseTex32, uv, 0.0).y;
		#endif
		#if STD_OPACITY_DITHER == IGNNOISE
			vec3 magic = vec3(0.06711056, 0.00583715, 52.9829189);
			float noise = fract(magic.z * fract(dot(gl_FragCoord.xy + blueNoiseJitter.xy + id, magic.xy)));
		#endif
	#endif
	noise = pow(noise, 2.2);
	if (alpha < noise)
		discard;
}
`;var yy=`
#ifdef PCOUTLINE_PASS
uniform vec3 pcOutlineColor;
#endif
`;var Cy=`
#ifdef PCOUTLINE_PASS
gl_FragColor.rgb = gammaCorrectOutput(pcOutlineColor);
#endif
`;var vy=`
`;var xy=`
#if LIT_BLEND_TYPE == NORMAL || LIT_BLEND_TYPE == ADDITIVEALPHA || defined(LIT_ALPHA_TO_COVERAGE)
	gl_FragColor.a = litArgs_opacity;
#elif LIT_BLEND_TYPE == PREMULTIPLIED
	gl_FragColor.rgb *= litArgs_opacity;
	gl_FragColor.a = litArgs_opacity;
#else
	gl_FragColor.a = 1.0;
#endif
`;var Ay=`
varying vec2 vUv0;
uniform sampler2D source;
void main(void) {
	gl_FragColor = texture2D(source, vUv0);
}
`;var Ry=`
uniform vec3 material_sheen;
void getSheen() {
	vec3 sheenColor = material_sheen;
	#ifdef STD_SHEEN_TEXTURE
	sheenColor *= {STD_SHEEN_TEXTURE_DECODE}(texture2DBias({STD_SHEEN_TEXTURE_NAME}, {STD_SHEEN_TEXTURE_UV}, {STD_TEXTURE_BIAS})).{STD_SHEEN_TEXTURE_CHANNEL};
	#endif
	#ifdef STD_SHEEN_VERTEX
	sheenColor *= saturate(vVertexColor.{STD_SHEEN_VERTEX_CHANNEL});
	#endif
	sSpecularity = sheenColor;
}
`;var Py=`
uniform float material_sheenGloss;
void getSheenGlossiness() {
	float sheenGlossiness = material_sheenGloss;
	#ifdef STD_SHEENGLOSS_TEXTURE
	sheenGlossiness *= texture2DBias({STD_SHEENGLOSS_TEXTURE_NAME}, {STD_SHEENGLOSS_TEXTURE_UV}, {STD_TEXTURE_BIAS}).{STD_SHEENGLOSS_TEXTURE_CHANNEL};
	#endif
	#ifdef STD_SHEENGLOSS_VERTEX
	sheenGlossiness *= saturate(vVertexColor.{STD_SHEENGLOSS_VERTEX_CHANNEL});
	#endif
	#ifdef STD_SHEENGLOSS_INVERT
	sheenGlossiness = 1.0 - sheenGlossiness;
	#endif
	sGlossiness = sheenGlossiness + 0.0000001;
}
`;var Dy=`
uniform float material_heightMapFactor;
uniform float material_heightMapBase;
#if STD_PARALLAX == OCCLUSION
	uniform float material_parallaxSamples;
	const float parallaxMaxSlope = 5.0;
	const float parallaxTexelsPerStep = 2.0;
	const float parallaxFadeMin = 1.0;
	const float parallaxFadeMax = 3.0;
	const int parallaxRefineSteps = 5;
#endif
void getParallax() {
	float parallaxScale = material_heightMapFactor;
	vec3 viewDirT = normalize(dViewDirW * dTBN);
	vec2 viewDirUv = vec2(viewDirT.x, -viewDirT.y);
	#if STD_PARALLAX == OCCLUSION
		vec2 march = -parallaxScale * viewDirUv / max(viewDirT.z, 0.0001);
		float marchLength = length(march);
		float maxMarchLength = parallaxScale * parallaxMaxSlope;
		vec2 uvSpan = marchLength > maxMarchLength ? march * (maxMarchLength / marchLength) : march;
		float geomDepth = 1.0 - material_heightMapBase;
		vec2 entryUv = {STD_HEIGHT_TEXTURE_UV} - uvSpan * geomDepth;
		vec2 heightMapSize = vec2(textureSize({STD_HEIGHT_TEXTURE_NAME}, 0));
		vec2 uvTexels = {STD_HEIGHT_TEXTURE_UV} * heightMapSize;
		vec2 texelsDx = dFdx(uvTexels);
		vec2 texelsDy = dFdy(uvTexels);
		float lod = max(0.0, 0.5 * log2(max(dot(texelsDx, texelsDx), dot(texelsDy, texelsDy))));
		float marchTexels = length(uvSpan * heightMapSize) / exp2(lod);
		float fade = clamp((marchTexels - parallaxFadeMin) / (parallaxFadeMax - parallaxFadeMin), 0.0, 1.0);
		dUvOffset = vec2(0.0);
		#ifdef STD_PARALLAX_SELF_SHADOW
			dParallaxHitDepth = 0.0;
			dParallaxLod = lod;
		#endif
		if (fade > 0.0) {
			float steps = clamp(marchTexels / parallaxTexelsPerStep, 1.0, material_parallaxSamples);
			float stepSize = 1.0 / steps;
			float rayDepth = 0.0;
			float surfaceDepth = 1.0 - texture2DLod({STD_HEIGHT_TEXTURE_NAME}, entryUv, lod).{STD_HEIGHT_TEXTURE_CHANNEL};
			float prevRayDepth = rayDepth;
			float prevSurfaceDepth = surfaceDepth;
			for (float i = 0.0; i < steps; i += 1.0) {
				if (rayDepth >= surfaceDepth) {
					break;
				}
				prevRayDepth = rayDepth;
				prevSurfaceDepth = surfaceDepth;
				rayDepth += stepSize;
				surfaceDepth = 1.0 - texture2DLod({STD_HEIGHT_TEXTURE_NAME}, entryUv + uvSpan * rayDepth, lod).{STD_HEIGHT_TEXTURE_CHANNEL};
			}
			float hitDepth = rayDepth;
			if (rayDepth >= surfaceDepth) {
				float interval = (rayDepth - prevRayDepth) * 0.5;
				hitDepth = rayDepth - interval;
				for (int i = 0; i < parallaxRefineSteps; i++) {
					interval *= 0.5;
					float refineDepth = 1.0 - texture2DLod({STD_HEIGHT_TEXTURE_NAME}, entryUv + uvSpan * hitDepth, lod).{STD_HEIGHT_TEXTURE_CHANNEL};
					hitDepth += hitDepth >= refineDepth ? -interval : interval;
				}
			}
			float hitBelowTop = clamp(hitDepth, 0.0, 1.0);
			dUvOffset = uvSpan * ((hitBelowTop - geomDepth) * fade);
			#ifdef STD_PARALLAX_SELF_SHADOW
				dParallaxHitDepth = hitBelowTop * fade;
			#endif
		}
	#else
		float height = texture2DBias({STD_HEIGHT_TEXTURE_NAME}, {STD_HEIGHT_TEXTURE_UV}, {STD_TEXTURE_BIAS}).{STD_HEIGHT_TEXTURE_CHANNEL};
		height = (height - material_heightMapBase) * parallaxScale;
		dUvOffset = height * viewDirUv;
	#endif
}
#ifdef STD_PARALLAX_SELF_SHADOW
	uniform float material_parallaxShadowSamples;
	const float parallaxShadowHardness = 16.0;
	const float parallaxShadowMaxSlope = 20.0;
	float getParallaxSelfShadow(vec3 lightDirNormW) {
		if (dParallaxHitDepth <= 0.0) {
			return 1.0;
		}
		vec3 lightDirT = normalize(-lightDirNormW * dTBN);
		vec2 lightDirUv = vec2(lightDirT.x, -lightDirT.y);
		if (lightDirT.z <= 0.0) {
			return 1.0;
		}
		float parallaxScale = material_heightMapFactor;
		vec2 climb = parallaxScale * lightDirUv / lightDirT.z;
		float climbLength = length(climb);
		float maxClimbLength = parallaxScale * parallaxShadowMaxSlope;
		vec2 uvPerDepth = climbLength > maxClimbLength ? climb * (maxClimbLength / climbLength) : climb;
		vec2 heightMapSize = vec2(textureSize({STD_HEIGHT_TEXTURE_NAME}, 0));
		float marchTexels = length(uvPerDepth * dParallaxHitDepth * heightMapSize) / exp2(dParallaxLod);
		float steps = clamp(marchTexels / parallaxTexelsPerStep, 1.0, material_parallaxShadowSamples);
		vec2 hitUv = {STD_HEIGHT_TEXTURE_UV} + dUvOffset;
		float blocked = 0.0;
		for (float i = 0.0; i < steps; i += 1.0) {
			float t = (i + 1.0) / steps;
			float climbed = dParallaxHitDepth * t;
			float rayDepth = dParallaxHitDepth - climbed;
			float fieldDepth = 1.0 - texture2DLod({STD_HEIGHT_TEXTURE_NAME}, hitUv + uvPerDepth * climbed, dParallaxLod).{STD_HEIGHT_TEXTURE_CHANNEL};
			blocked = max(blocked, max(0.0, rayDepth - fieldDepth) * max(0.0, 1.0 - t));
		}
		return clamp(1.0 - blocked * parallaxShadowHardness, 0.0, 1.0);
	}
#endif
`;var Iy=`
vec4 encodePickOutput(uint id) {
	const vec4 inv = vec4(1.0 / 255.0);
	const uvec4 shifts = uvec4(16, 8, 0, 24);
	uvec4 col = (uvec4(id) >> shifts) & uvec4(0xff);
	return vec4(col) * inv;
}
#ifndef PICK_CUSTOM_ID
	uniform uint meshInstanceId;
	vec4 getPickOutput() {
		return encodePickOutput(meshInstanceId);
	}
#endif
#ifdef DEPTH_PICK_PASS
	#include "floatAsUintPS"
	#ifndef CAMERAPLANES
		#define CAMERAPLANES
		uniform vec4 camera_params;
	#endif
	vec4 getPickDepth() {
		float linearDepth;
		if (camera_params.w > 0.5) {
			linearDepth = gl_FragCoord.z;
		} else {
			float viewDist = 1.0 / gl_FragCoord.w;
			linearDepth = (viewDist - camera_params.z) / (camera_params.y - camera_params.z);
		}
		return float2uint(linearDepth);
	}
#endif
`;var wy=`
void getReflDir(vec3 worldNormal, vec3 viewDir, float gloss, mat3 tbn) {
	dReflDirW = normalize(-reflect(viewDir, worldNormal));
}
`;var My=`
void getReflDir(vec3 worldNormal, vec3 viewDir, float gloss, mat3 tbn) {
	float roughness = sqrt(1.0 - min(gloss, 1.0));
	vec2 direction = dAnisotropyRotation;
	vec3 anisotropicT = normalize(tbn * vec3(direction, 0.0));
	vec3 anisotropicB = normalize(cross(tbn[2], anisotropicT));
	float anisotropy = dAnisotropy;
	vec3 anisotropicDirection = anisotropicB;
	vec3 anisotropicTangent = cross(anisotropicDirection, viewDir);
	vec3 anisotropicNormal = cross(anisotropicTangent, anisotropicDirection);
	float bendFactor = 1.0 - anisotropy * (1.0 - roughness);
	float bendFactor4 = bendFactor * bendFactor * bendFactor * bendFactor;
	vec3 bentNormal = normalize(mix(normalize(anisotropicNormal), normalize(worldNormal), bendFactor4));
	dReflDirW = reflect(-viewDir, bentNormal);
}
`;var Ly=`
#ifdef LIT_CLEARCOAT
void addReflectionCC(vec3 reflDir, float gloss) {
	ccReflection += calcReflection(reflDir, gloss);
}
#endif
`;var by=`
uniform samplerCube {LIT_ENV_CUBEMAP};
uniform float material_reflectivity;
vec3 calcReflection(vec3 reflDir, float gloss) {
	vec3 lookupVec = cubeMapProject(reflDir);
	lookupVec.x *= -1.0;
	return {reflectionDecode}(textureCube({LIT_ENV_CUBEMAP}, lookupVec));
}
void addReflection(vec3 reflDir, float gloss) {   
	dReflection += vec4(calcReflection(reflDir, gloss), material_reflectivity);
}
`;var Fy=`
#ifndef ENV_ATLAS
	#define ENV_ATLAS
	uniform sampler2D {LIT_ENV_ATLAS};
#endif
uniform samplerCube {LIT_ENV_CUBEMAP};
uniform float material_reflectivity;
vec3 calcReflection(vec3 reflDir, float gloss) {
	vec3 dir = cubeMapProject(reflDir) * vec3(-1.0, 1.0, 1.0);
	vec2 uv = toSphericalUv(dir);
	float level = saturate(1.0 - gloss) * 5.0;
	float ilevel = floor(level);
	float flevel = level - ilevel;
	vec3 sharp = {reflectionCubemapDecode}(textureCube({LIT_ENV_CUBEMAP}, dir));
	vec3 roughA = {reflectionDecode}(texture2D({LIT_ENV_ATLAS}, mapRoughnessUv(uv, ilevel)));
	vec3 roughB = {reflectionDecode}(texture2D({LIT_ENV_ATLAS}, mapRoughnessUv(uv, ilevel + 1.0)));
	return processEnvironment(mix(sharp, mix(roughA, roughB, flevel), min(level, 1.0)));
}
void addReflection(vec3 reflDir, float gloss) {   
	dReflection += vec4(calcReflection(reflDir, gloss), material_reflectivity);
}
`;var Oy=`
#ifndef ENV_ATLAS
#define ENV_ATLAS
	uniform sampler2D {LIT_ENV_ATLAS};
#endif
uniform float material_reflectivity;
float shinyMipLevel(vec2 uv) {
	vec2 dx = dFdx(uv);
	vec2 dy = dFdy(uv);
	vec2 uv2 = vec2(fract(uv.x + 0.5), uv.y);
	vec2 dx2 = dFdx(uv2);
	vec2 dy2 = dFdy(uv2);
	float maxd = min(max(dot(dx, dx), dot(dy, dy)), max(dot(dx2, dx2), dot(dy2, dy2)));
	return clamp(0.5 * log2(maxd) - 1.0 + textureBias, 0.0, 5.0);
}
vec3 calcReflection(vec3 reflDir, float gloss) {
	vec3 dir = cubeMapProject(reflDir) * vec3(-1.0, 1.0, 1.0);
	vec2 uv = toSphericalUv(dir);
	float level = saturate(1.0 - gloss) * 5.0;
	float ilevel = floor(level);
	float level2 = shinyMipLevel(uv * atlasSize);
	float ilevel2 = floor(level2);
	vec2 uv0, uv1;
	float weight;
	if (ilevel == 0.0) {
		uv0 = mapShinyUv(uv, ilevel2);
		uv1 = mapShinyUv(uv, ilevel2 + 1.0);
		weight = level2 - ilevel2;
	} else {
		uv0 = uv1 = mapRoughnessUv(uv, ilevel);
		weight = 0.0;
	}
	vec3 linearA = {reflectionDecode}(texture2D({LIT_ENV_ATLAS}, uv0));
	vec3 linearB = {reflectionDecode}(texture2D({LIT_ENV_ATLAS}, uv1));
	vec3 linear0 = mix(linearA, linearB, weight);
	vec3 linear1 = {reflectionDecode}(texture2D({LIT_ENV_ATLAS}, mapRoughnessUv(uv, ilevel + 1.0)));
	return processEnvironment(mix(linear0, linear1, level - ilevel));
}
void addReflection(vec3 reflDir, float gloss) {   
	dReflection += vec4(calcReflection(reflDir, gloss), material_reflectivity);
}
`;var Ny=`
#ifndef VIEWMATRIX
	#define VIEWMATRIX
	uniform mat4 matrix_view;
#endif
uniform sampler2D texture_sphereMap;
uniform float material_reflectivity;
vec3 calcReflection(vec3 reflDir, float gloss) {
	vec3 reflDirV = (mat3(matrix_view) * reflDir);
	float m = 2.0 * sqrt(dot(reflDirV.xy, reflDirV.xy) + (reflDirV.z + 1.0) * (reflDirV.z + 1.0));
	vec2 sphereMapUv = reflDirV.xy / m + 0.5;
	return {reflectionDecode}(texture2D(texture_sphereMap, sphereMapUv));
}
void addReflection(vec3 reflDir, float gloss) {   
	dReflection += vec4(calcReflection(reflDir, gloss), material_reflectivity);
}
`;var By=`
void addReflectionSheen(vec3 worldNormal, vec3 viewDir, float gloss) {
	float NoV = dot(worldNormal, viewDir);
	float alphaG = gloss * gloss;
	float a = gloss < 0.25 ? -339.2 * alphaG + 161.4 * gloss - 25.9 : -8.48 * alphaG + 14.3 * gloss - 9.95;
	float b = gloss < 0.25 ? 44.0 * alphaG - 23.7 * gloss + 3.26 : 1.97 * alphaG - 3.27 * gloss + 0.72;
	float DG = exp( a * NoV + b ) + ( gloss < 0.25 ? 0.0 : 0.1 * ( gloss - 0.25 ) );
	sReflection += calcReflection(worldNormal, 0.0) * saturate(DG);
}
`;var Uy=`
vec3 refract2(vec3 viewVec, vec3 normal, float IOR) {
	float vn = dot(viewVec, normal);
	float k = 1.0 - IOR * IOR * (1.0 - vn * vn);
	vec3 refrVec = IOR * viewVec - (IOR * vn + sqrt(k)) * normal;
	return refrVec;
}
void addRefraction(
	vec3 worldNormal, 
	vec3 viewDir, 
	float thickness, 
	float gloss, 
	vec3 specularity, 
	vec3 albedo, 
	float transmission,
	float refractionIndex,
	float dispersion
#if defined(LIT_IRIDESCENCE)
	, vec3 iridescenceFresnel,
	float iridescenceIntensity
#endif 
) {
	vec4 tmpRefl = dReflection;
	vec3 reflectionDir = refract2(-viewDir, worldNormal, refractionIndex);
	dReflection = vec4(0);
	addReflection(reflectionDir, gloss);
	dDiffuseLight = mix(dDiffuseLight, dReflection.rgb * albedo, transmission);
	dReflection = tmpRefl;
}
`;var ky=`
uniform float material_invAttenuationDistance;
uniform vec3 material_attenuation;
vec3 evalRefractionColor(vec3 refractionVector, float gloss, float refractionIndex) {
	vec4 pointOfRefraction = vec4(vPositionW + refractionVector, 1.0);
	vec4 projectionPoint = matrix_viewProjection * pointOfRefraction;
	vec2 uv = getGrabScreenPos(projectionPoint);
	float iorToRoughness = (1.0 - gloss) * clamp((1.0 / refractionIndex) * 2.0 - 2.0, 0.0, 1.0);
	float refractionLod = log2(screen_size.x) * iorToRoughness;
	vec3 refraction = texture2DLod(uSceneColorMap, uv, refractionLod).rgb;
	#ifdef SCENE_COLORMAP_GAMMA
		refraction = decodeGamma(refraction);
	#endif
	return refraction;
}
void addRefraction(
	vec3 worldNormal, 
	vec3 viewDir, 
	float thickness, 
	float gloss, 
	vec3 specularity, 
	vec3 albedo, 
	float transmission,
	float refractionIndex,
	float dispersion
#if defined(LIT_IRIDESCENCE)
	, vec3 iridescenceFresnel,
	float iridescenceIntensity
#endif
) {
	vec3 scale = thickness * vModelScale;
	vec3 refractionVector = normalize(refract(-viewDir, worldNormal, refractionIndex)) * scale;
	vec3 refraction = evalRefractionColor(refractionVector, gloss, refractionIndex);
	#ifdef LIT_DISPERSION
		float halfSpread = (1.0 / refractionIndex - 1.0) * 0.025 * dispersion;
		float refractionIndexR = refractionIndex - halfSpread;
		refractionVector = normalize(refract(-viewDir, worldNormal, refractionIndexR)) * scale;
		refraction.r = evalRefractionColor(refractionVector, gloss, refractionIndexR).r;
		float refractionIndexB = refractionIndex + halfSpread;
		refractionVector = normalize(refract(-viewDir, worldNormal, refractionIndexB)) * scale;
		refraction.b = evalRefractionColor(refractionVector, gloss, refractionIndexB).b;
	#endif
	vec3 transmittance;
	if (material_invAttenuationDistance != 0.0)
	{
		vec3 attenuation = -log(material_attenuation) * material_invAttenuationDistance;
		transmittance = exp(-attenuation * length(refractionVector));
	}
	else
	{
		transmittance = vec3(1.0);
	}
	vec3 fresnel = vec3(1.0) - 
		getFresnel(
			dot(viewDir, worldNormal), 
			gloss, 
			specularity
		#if defined(LIT_IRIDESCENCE)
			, iridescenceFresnel,
			iridescenceIntensity
		#endif
		);
	dDiffuseLight = mix(dDiffuseLight, refraction * transmittance * fresnel, transmission);
}
`;var Gy=`
varying vec2 vUv0;
#ifdef CUBEMAP_SOURCE
	uniform samplerCube sourceCube;
#else
	uniform sampler2D sourceTex;
#endif
#ifdef USE_SAMPLES_TEX
	uniform sampler2D samplesTex;
	uniform vec2 samplesTexInverseSize;
#endif
uniform vec3 params;
float targetFace() { return params.x; }
float targetTotalPixels() { return params.y; }
float sourceTotalPixels() { return params.z; }
float PI = 3.141592653589793;
float saturate(float x) {
	return clamp(x, 0.0, 1.0);
}
#include "decodePS"
#include "encodePS"
vec3 modifySeams(vec3 dir, float scale) {
	vec3 adir = abs(dir);
	float M = max(max(adir.x, adir.y), adir.z);
	return dir / M * vec3(
		adir.x == M ? 1.0 : scale,
		adir.y == M ? 1.0 : scale,
		adir.z == M ? 1.0 : scale
	);
}
vec2 toSpherical(vec3 dir) {
	return vec2(dir.xz == vec2(0.0) ? 0.0 : atan(dir.x, dir.z), asin(dir.y));
}
vec3 fromSpherical(vec2 uv) {
	return vec3(cos(uv.y) * sin(uv.x),
				sin(uv.y),
				cos(uv.y) * cos(uv.x));
}
vec3 getDirectionEquirect() {
	return fromSpherical((vec2(vUv0.x, 1.0 - vUv0.y) * 2.0 - 1.0) * vec2(PI, PI * 0.5));
}
float signNotZero(float k){
	return(k >= 0.0) ? 1.0 : -1.0;
}
vec2 signNotZero(vec2 v) {
	return vec2(signNotZero(v.x), signNotZero(v.y));
}
vec3 octDecode(vec2 o) {
	vec3 v = vec3(o.x, 1.0 - abs(o.x) - abs(o.y), o.y);
	if (v.y < 0.0) {
		v.xz = (1.0 - abs(v.zx)) * signNotZero(v.xz);
	}
	return normalize(v);
}
vec3 getDirectionOctahedral() {
	return octDecode(vec2(vUv0.x, 1.0 - vUv0.y) * 2.0 - 1.0);
}
vec2 octEncode(in vec3 v) {
	float l1norm = abs(v.x) + abs(v.y) + abs(v.z);
	vec2 result = v.xz * (1.0 / l1norm);
	if (v.y < 0.0) {
		result = (1.0 - abs(result.yx)) * signNotZero(result.xy);
	}
	return result;
}
#ifdef CUBEMAP_SOURCE
	vec4 sampleCubemap(vec3 dir) {
		return textureCube(sourceCube, modifySeams(dir, 1.0));
	}
	vec4 sampleCubemap(vec2 sph) {
		return sampleCubemap(fromSpherical(sph));
	}
	vec4 sampleCubemap(vec3 dir, float mipLevel) {
		return textureCubeLod(sourceCube, modifySeams(dir, 1.0), mipLevel);
	}
	vec4 sampleCubemap(vec2 sph, float mipLevel) {
		return sampleCubemap(fromSpherical(sph), mipLevel);
	}
#else
	vec4 sampleEquirect(vec2 sph) {
		vec2 uv = sph / vec2(PI * 2.0, PI) + 0.5;
		return texture2D(sourceTex, vec2(uv.x, 1.0 - uv.y));
	}
	vec4 sampleEquirect(vec3 dir) {
		return sampleEquirect(toSpherical(dir));
	}
	vec4 sampleEquirect(vec2 sph, float mipLevel) {
		vec2 uv = sph / vec2(PI * 2.0, PI) + 0.5;
		return texture2DLod(sourceTex, vec2(uv.x, 1.0 - uv.y), mipLevel);
	}
	vec4 sampleEquirect(vec3 dir, float mipLevel) {
		return sampleEquirect(toSpherical(dir), mipLevel);
	}
	vec4 sampleOctahedral(vec3 dir) {
		vec2 uv = octEncode(dir) * 0.5 + 0.5;
		return texture2D(sourceTex, vec2(uv.x, 1.0 - uv.y));
	}
	vec4 sampleOctahedral(vec2 sph) {
		return sampleOctahedral(fromSpherical(sph));
	}
	vec4 sampleOctahedral(vec3 dir, float mipLevel) {
		vec2 uv = octEncode(dir) * 0.5 + 0.5;
		return texture2DLod(sourceTex, vec2(uv.x, 1.0 - uv.y), mipLevel);
	}
	vec4 sampleOctahedral(vec2 sph, float mipLevel) {
		return sampleOctahedral(fromSpherical(sph), mipLevel);
	}
#endif
vec3 getDirectionCubemap() {
	vec2 st = vUv0 * 2.0 - 1.0;
	float face = targetFace();
	vec3 vec;
	if (face == 0.0) {
		vec = vec3(1, -st.y, -st.x);
	} else if (face == 1.0) {
		vec = vec3(-1, -st.y, st.x);
	} else if (face == 2.0) {
		vec = vec3(st.x, 1, st.y);
	} else if (face == 3.0) {
		vec = vec3(st.x, -1, -st.y);
	} else if (face == 4.0) {
		vec = vec3(st.x, -st.y, 1);
	} else {
		vec = vec3(-st.x, -st.y, -1);
	}
	return normalize(modifySeams(vec, 1.0));
}
mat3 matrixFromVector(vec3 n) {
	float a = 1.0 / (1.0 + n.z);
	float b = -n.x * n.y * a;
	vec3 b1 = vec3(1.0 - n.x * n.x * a, b, -n.x);
	vec3 b2 = vec3(b, 1.0 - n.y * n.y * a, -n.y);
	return mat3(b1, b2, n);
}
mat3 matrixFromVectorSlow(vec3 n) {
	vec3 up = (1.0 - abs(n.y) <= 0.0000001) ? vec3(0.0, 0.0, n.y > 0.0 ? 1.0 : -1.0) : vec3(0.0, 1.0, 0.0);
	vec3 x = normalize(cross(up, n));
	vec3 y = cross(n, x);
	return mat3(x, y, n);
}
vec4 reproject() {
	if ({NUM_SAMPLES} <= 1) {
		return {ENCODE_FUNC}({DECODE_FUNC}({SOURCE_FUNC}({TARGET_FUNC}())));
	} else {
		vec3 t = {TARGET_FUNC}();
		vec3 tu = dFdx(t);
		vec3 tv = dFdy(t);
		vec3 result = vec3(0.0);
		for (float u = 0.0; u < {NUM_SAMPLES_SQRT}; ++u) {
			for (float v = 0.0; v < {NUM_SAMPLES_SQRT}; ++v) {
				result += {DECODE_FUNC}({SOURCE_FUNC}(normalize(t +
															tu * (u / {NUM_SAMPLES_SQRT} - 0.5) +
															tv * (v / {NUM_SAMPLES_SQRT} - 0.5))));
			}
		}
		return {ENCODE_FUNC}(result / ({NUM_SAMPLES_SQRT} * {NUM_SAMPLES_SQRT}));
	}
}
vec4 unpackFloat = vec4(1.0, 1.0 / 255.0, 1.0 / 65025.0, 1.0 / 16581375.0);
#ifdef USE_SAMPLES_TEX
	void unpackSample(int i, out vec3 L, out float mipLevel) {
		float u = (float(i * 4) + 0.5) * samplesTexInverseSize.x;
		float v = (floor(u) + 0.5) * samplesTexInverseSize.y;
		vec4 raw;
		raw.x = dot(texture2D(samplesTex, vec2(u, v)), unpackFloat); u += samplesTexInverseSize.x;
		raw.y = dot(texture2D(samplesTex, vec2(u, v)), unpackFloat); u += samplesTexInverseSize.x;
		raw.z = dot(texture2D(samplesTex, vec2(u, v)), unpackFloat); u += samplesTexInverseSize.x;
		raw.w = dot(texture2D(samplesTex, vec2(u, v)), unpackFloat);
		L.xyz = raw.xyz * 2.0 - 1.0;
		mipLevel = raw.w * 8.0;
	}
	vec4 prefilterSamples() {
		mat3 vecSpace = matrixFromVectorSlow({TARGET_FUNC}());
		vec3 L;
		float mipLevel;
		vec3 result = vec3(0.0);
		float totalWeight = 0.0;
		for (int i = 0; i < {NUM_SAMPLES}; ++i) {
			unpackSample(i, L, mipLevel);
			result += {DECODE_FUNC}({SOURCE_FUNC}(vecSpace * L, mipLevel)) * L.z;
			totalWeight += L.z;
		}
		return {ENCODE_FUNC}(result / totalWeight);
	}
	vec4 prefilterSamplesUnweighted() {
		mat3 vecSpace = matrixFromVectorSlow({TARGET_FUNC}());
		vec3 L;
		float mipLevel;
		vec3 result = vec3(0.0);
		float totalWeight = 0.0;
		for (int i = 0; i < {NUM_SAMPLES}; ++i) {
			unpackSample(i, L, mipLevel);
			result += {DECODE_FUNC}({SOURCE_FUNC}(vecSpace * L, mipLevel));
		}
		return {ENCODE_FUNC}(result / float({NUM_SAMPLES}));
	}
#endif
void main(void) {
	gl_FragColor = {PROCESS_FUNC}();
}
`;var Vy=`
attribute vec2 vertex_position;
uniform vec4 uvMod;
varying vec2 vUv0;
void main(void) {
	gl_Position = vec4(vertex_position, 0.5, 1.0);
	vUv0 = getImageEffectUV((vertex_position.xy * 0.5 + 0.5) * uvMod.xy + uvMod.zw);
}
`;var zy=`
uniform highp sampler2D uSceneDepthMap;
#if defined(SCENE_DEPTHMAP_LINEAR) && defined(SCENE_DEPTHMAP_PACKED)
	#include "floatAsUintPS"
#endif
#ifndef SCREENSIZE
	#define SCREENSIZE
	uniform vec4 screen_size;
#endif
#ifndef VIEWMATRIX
	#define VIEWMATRIX
	uniform mat4 matrix_view;
#endif
#ifndef LINEARIZE_DEPTH
	#define LINEARIZE_DEPTH
	
	#ifndef CAMERAPLANES
		#define CAMERAPLANES
		uniform vec4 camera_params;
	#endif
	float linearizeDepth(float z) {
		if (camera_params.w == 0.0)
			return (camera_params.z * camera_params.y) / (camera_params.y + z * (camera_params.z - camera_params.y));
		else
			return camera_params.z + z * (camera_params.y - camera_params.z);
	}
#endif
float delinearizeDepth(float linearDepth) {
	if (camera_params.w == 0.0) {
		return (camera_params.y * (camera_params.z - linearDepth)) / (linearDepth * (camera_params.z - camera_params.y));
	} else {
		return (linearDepth - camera_params.z) / (camera_params.y - camera_params.z);
	}
}
float getLinearScreenDepth(vec2 uv) {
	#ifdef SCENE_DEPTHMAP_LINEAR
		#ifdef SCENE_DEPTHMAP_PACKED
			ivec2 texel = ivec2(uv * vec2(textureSize(uSceneDepthMap, 0)));
			return uint2float(texelFetch(uSceneDepthMap, texel, 0));
		#elif defined(SCENE_DEPTHMAP_RECIPROCAL)
			float recip = texture2D(uSceneDepthMap, uv).r;
			return recip > 0.0 ? 1.0 / recip : camera_params.y;
		#else
			return texture2D(uSceneDepthMap, uv).r;
		#endif
	#else
		return linearizeDepth(texture2D(uSceneDepthMap, uv).r);
	#endif
}
#ifndef VERTEXSHADER
	float getLinearScreenDepth() {
		vec2 uv = gl_FragCoord.xy * screen_size.zw;
		return getLinearScreenDepth(uv);
	}
#endif
float getLinearDepth(vec3 pos) {
	return -(matrix_view * vec4(pos, 1.0)).z;
}
`;var Hy=`
int getShadowCascadeIndex(vec4 shadowCascadeDistances, int shadowCascadeCount) {
	float depth = 1.0 / gl_FragCoord.w;
	vec4 comparisons = step(shadowCascadeDistances, vec4(depth));
	int cascadeIndex = int(dot(comparisons, vec4(1.0)));
	return min(cascadeIndex, shadowCascadeCount - 1);
}
int ditherShadowCascadeIndex(int cascadeIndex, vec4 shadowCascadeDistances, int shadowCascadeCount, float blendFactor) {
 
	if (cascadeIndex < shadowCascadeCount - 1) {
		float currentRangeEnd = shadowCascadeDistances[cascadeIndex];
		float transitionStart = blendFactor * currentRangeEnd;
		float depth = 1.0 / gl_FragCoord.w;
		if (depth > transitionStart) {
			float transitionFactor = smoothstep(transitionStart, currentRangeEnd, depth);
			float dither = fract(sin(dot(gl_FragCoord.xy, vec2(12.9898, 78.233))) * 43758.5453);
			if (dither < transitionFactor) {
				cascadeIndex += 1;
			}
		}
	}
	return cascadeIndex;
}
`;var Wy=`
vec4 getShadowOutput() {
	float depth = gl_FragCoord.z;
	#if SHADOW_TYPE == VSM_16F || SHADOW_TYPE == VSM_32F
		if (!(depth >= 0.0 && depth <= 1.0)) discard;
		#if SHADOW_TYPE == VSM_32F
			float exponent = 15.0;
		#else
			float exponent = 5.54;
		#endif
		depth = 2.0 * depth - 1.0;
		depth = exp(exponent * depth);
		return vec4(depth, depth * depth, 1.0, 1.0);
	#elif SHADOW_TYPE == PCSS_32F
		return vec4(depth, 0.0, 0.0, 1.0);
	#else
		return vec4(1.0);
	#endif
}
`;var Xy=`
float linstep(float a, float b, float v) {
	return saturate((v - a) / (b - a));
}
float reduceLightBleeding(float pMax, float amount) {
	 return linstep(amount, 1.0, pMax);
}
float chebyshevUpperBound(vec2 moments, float mean, float minVariance, float lightBleedingReduction) {
	float variance = moments.y - (moments.x * moments.x);
	variance = max(variance, minVariance);
	float d = mean - moments.x;
	float pMax = variance / (variance + (d * d));
	pMax = reduceLightBleeding(pMax, lightBleedingReduction);
	return (mean <= moments.x ? 1.0 : pMax);
}
float calculateEVSM(vec3 moments, float Z, float vsmBias, float exponent) {
	Z = 2.0 * Z - 1.0;
	float warpedDepth = exp(exponent * Z);
	moments.xy += vec2(warpedDepth, warpedDepth*warpedDepth) * (1.0 - moments.z);
	float VSMBias = vsmBias;
	float depthScale = VSMBias * exponent * warpedDepth;
	float minVariance1 = depthScale * depthScale;
	return chebyshevUpperBound(moments.xy, warpedDepth, minVariance1, 0.1);
}
float VSM16(TEXTURE_ACCEPT(tex), vec2 texCoords, float resolution, float Z, float vsmBias, float exponent) {
	vec3 moments = texture2DLod(tex, texCoords, 0.0).xyz;
	return calculateEVSM(moments, Z, vsmBias, exponent);
}
float getShadowVSM16(TEXTURE_ACCEPT(shadowMap), vec3 shadowCoord, vec4 shadowParams, float exponent) {
	return VSM16(TEXTURE_PASS(shadowMap), shadowCoord.xy, shadowParams.x, shadowCoord.z, shadowParams.y, exponent);
}
float getShadowSpotVSM16(TEXTURE_ACCEPT(shadowMap), vec3 shadowCoord, vec4 shadowParams, float exponent, vec3 lightDir) {
	return VSM16(TEXTURE_PASS(shadowMap), shadowCoord.xy, shadowParams.x, length(lightDir) * shadowParams.w + shadowParams.z, shadowParams.y, exponent);
}
float VSM32(TEXTURE_ACCEPT(tex), vec2 texCoords, float resolution, float Z, float vsmBias, float exponent) {
	#ifdef CAPS_TEXTURE_FLOAT_FILTERABLE
		vec3 moments = texture2DLod(tex, texCoords, 0.0).xyz;
	#else
		float pixelSize = 1.0 / resolution;
		texCoords -= vec2(pixelSize);
		vec3 s00 = texture2DLod(tex, texCoords, 0.0).xyz;
		vec3 s10 = texture2DLod(tex, texCoords + vec2(pixelSize, 0), 0.0).xyz;
		vec3 s01 = texture2DLod(tex, texCoords + vec2(0, pixelSize), 0.0).xyz;
		vec3 s11 = texture2DLod(tex, texCoords + vec2(pixelSize), 0.0).xyz;
		vec2 fr = fract(texCoords * resolution);
		vec3 h0 = mix(s00, s10, fr.x);
		vec3 h1 = mix(s01, s11, fr.x);
		vec3 moments = mix(h0, h1, fr.y);
	#endif
	return calculateEVSM(moments, Z, vsmBias, exponent);
}
float getShadowVSM32(TEXTURE_ACCEPT(shadowMap), vec3 shadowCoord, vec4 shadowParams, float exponent) {
	return VSM32(TEXTURE_PASS(shadowMap), shadowCoord.xy, shadowParams.x, shadowCoord.z, shadowParams.y, exponent);
}
float getShadowSpotVSM32(TEXTURE_ACCEPT(shadowMap), vec3 shadowCoord, vec4 shadowParams, float exponent, vec3 lightDir) {
	float Z = length(lightDir) * shadowParams.w + shadowParams.z;
	return VSM32(TEXTURE_PASS(shadowMap), shadowCoord.xy, shadowParams.x, Z, shadowParams.y, exponent);
}
`;var Yy=`
float getShadowPCF1x1(SHADOWMAP_ACCEPT(shadowMap), vec3 shadowCoord, vec4 shadowParams) {
	return textureShadow(shadowMap, shadowCoord);
}
float getShadowSpotPCF1x1(SHADOWMAP_ACCEPT(shadowMap), vec3 shadowCoord, vec4 shadowParams) {
	return textureShadow(shadowMap, shadowCoord);
}
#ifndef WEBGPU
float getShadowOmniPCF1x1(samplerCubeShadow shadowMap, vec3 shadowCoord, vec4 shadowParams, vec3 lightDir) {
	float shadowZ = length(lightDir) * shadowParams.w + shadowParams.z;
	return texture(shadowMap, vec4(lightDir, shadowZ));
}
#endif
`;var jy=`
float _getShadowPCF3x3(SHADOWMAP_ACCEPT(shadowMap), vec3 shadowCoord, vec3 shadowParams) {
	float z = shadowCoord.z;
	vec2 uv = shadowCoord.xy * shadowParams.x;
	float shadowMapSizeInv = 1.0 / shadowParams.x;
	vec2 base_uv = floor(uv + 0.5);
	float s = (uv.x + 0.5 - base_uv.x);
	float t = (uv.y + 0.5 - base_uv.y); 
	base_uv -= vec2(0.5);
	base_uv *= shadowMapSizeInv;
	float sum = 0.0;
	float uw0 = (3.0 - 2.0 * s);
	float uw1 = (1.0 + 2.0 * s);
	float u0 = (2.0 - s) / uw0 - 1.0;
	float u1 = s / uw1 + 1.0;
	float vw0 = (3.0 - 2.0 * t);
	float vw1 = (1.0 + 2.0 * t);
	float v0 = (2.0 - t) / vw0 - 1.0;
	float v1 = t / vw1 + 1.0;
	u0 = u0 * shadowMapSizeInv + base_uv.x;
	v0 = v0 * shadowMapSizeInv + base_uv.y;
	u1 = u1 * shadowMapSizeInv + base_uv.x;
	v1 = v1 * shadowMapSizeInv + base_uv.y;
	sum += uw0 * vw0 * textureShadow(shadowMap, vec3(u0, v0, z));
	sum += uw1 * vw0 * textureShadow(shadowMap, vec3(u1, v0, z));
	sum += uw0 * vw1 * textureShadow(shadowMap, vec3(u0, v1, z));
	sum += uw1 * vw1 * textureShadow(shadowMap, vec3(u1, v1, z));
	sum *= 1.0f / 16.0;
	return sum;
}
float getShadowPCF3x3(SHADOWMAP_ACCEPT(shadowMap), vec3 shadowCoord, vec4 shadowParams) {
	return _getShadowPCF3x3(SHADOWMAP_PASS(shadowMap), shadowCoord, shadowParams.xyz);
}
float getShadowSpotPCF3x3(SHADOWMAP_ACCEPT(shadowMap), vec3 shadowCoord, vec4 shadowParams) {
	return _getShadowPCF3x3(SHADOWMAP_PASS(shadowMap), shadowCoord, shadowParams.xyz);
}
#ifndef WEBGPU
float getShadowOmniPCF3x3(samplerCubeShadow shadowMap, vec4 shadowParams, vec3 dir) {
	
	float shadowZ = length(dir) * shadowParams.w + shadowParams.z;
	float z = 1.0 / float(textureSize(shadowMap, 0));
	vec3 tc = normalize(dir);
	mediump vec4 shadows;
	shadows.x = texture(shadowMap, vec4(tc + vec3( z, z, z), shadowZ));
	shadows.y = texture(shadowMap, vec4(tc + vec3(-z,-z, z), shadowZ));
	shadows.z = texture(shadowMap, vec4(tc + vec3(-z, z,-z), shadowZ));
	shadows.w = texture(shadowMap, vec4(tc + vec3( z,-z,-z), shadowZ));
	return dot(shadows, vec4(0.25));
}
float getShadowOmniPCF3x3(samplerCubeShadow shadowMap, vec3 shadowCoord, vec4 shadowParams, vec3 lightDir) {
	return getShadowOmniPCF3x3(shadowMap, shadowParams, lightDir);
}
#endif
`;var qy=`
float _getShadowPCF5x5(SHADOWMAP_ACCEPT(shadowMap), vec3 shadowCoord, vec3 shadowParams) {
	float z = shadowCoord.z;
	vec2 uv = shadowCoord.xy * shadowParams.x;
	float shadowMapSizeInv = 1.0 / shadowParams.x;
	vec2 base_uv = floor(uv + 0.5);
	float s = (uv.x + 0.5 - base_uv.x);
	float t = (uv.y + 0.5 - base_uv.y);
	base_uv -= vec2(0.5);
	base_uv *= shadowMapSizeInv;
	float uw0 = (4.0 - 3.0 * s);
	float uw1 = 7.0;
	float uw2 = (1.0 + 3.0 * s);
	float u0 = (3.0 - 2.0 * s) / uw0 - 2.0;
	float u1 = (3.0 + s) / uw1;
	float u2 = s / uw2 + 2.0;
	float vw0 = (4.0 - 3.0 * t);
	float vw1 = 7.0;
	float vw2 = (1.0 + 3.0 * t);
	float v0 = (3.0 - 2.0 * t) / vw0 - 2.0;
	float v1 = (3.0 + t) / vw1;
	float v2 = t / vw2 + 2.0;
	float sum = 0.0;
	u0 = u0 * shadowMapSizeInv + base_uv.x;
	v0 = v0 * shadowMapSizeInv + base_uv.y;
	u1 = u1 * shadowMapSizeInv + base_uv.x;
	v1 = v1 * shadowMapSizeInv + base_uv.y;
	u2 = u2 * shadowMapSizeInv + base_uv.x;
	v2 = v2 * shadowMapSizeInv + base_uv.y;
	sum += uw0 * vw0 * textureShadow(shadowMap, vec3(u0, v0, z));
	sum += uw1 * vw0 * textureShadow(shadowMap, vec3(u1, v0, z));
	sum += uw2 * vw0 * textureShadow(shadowMap, vec3(u2, v0, z));
	sum += uw0 * vw1 * textureShadow(shadowMap, vec3(u0, v1, z));
	sum += uw1 * vw1 * textureShadow(shadowMap, vec3(u1, v1, z));
	sum += uw2 * vw1 * textureShadow(shadowMap, vec3(u2, v1, z));
	sum += uw0 * vw2 * textureShadow(shadowMap, vec3(u0, v2, z));
	sum += uw1 * vw2 * textureShadow(shadowMap, vec3(u1, v2, z));
	sum += uw2 * vw2 * textureShadow(shadowMap, vec3(u2, v2, z));
	sum *= 1.0f / 144.0;
	sum = saturate(sum);
	return sum;
}
float getShadowPCF5x5(SHADOWMAP_ACCEPT(shadowMap), vec3 shadowCoord, vec4 shadowParams) {
	return _getShadowPCF5x5(SHADOWMAP_PASS(shadowMap), shadowCoord, shadowParams.xyz);
}
float getShadowSpotPCF5x5(SHADOWMAP_ACCEPT(shadowMap), vec3 shadowCoord, vec4 shadowParams) {
	return _getShadowPCF5x5(SHADOWMAP_PASS(shadowMap), shadowCoord, shadowParams.xyz);
}
`;var $y=`
#define PCSS_SAMPLE_COUNT 16
uniform float pcssDiskSamples[PCSS_SAMPLE_COUNT];
uniform float pcssSphereSamples[PCSS_SAMPLE_COUNT];
vec2 vogelDisk(int sampleIndex, float count, float phi, float r) {
	const float GoldenAngle = 2.4;
	float theta = float(sampleIndex) * GoldenAngle + phi;
	float sine = sin(theta);
	float cosine = cos(theta);
	return vec2(r * cosine, r * sine);
}
vec3 vogelSphere(int sampleIndex, float count, float phi, float r) {
	const float GoldenAngle = 2.4;
	float theta = float(sampleIndex) * GoldenAngle + phi;
	float weight = float(sampleIndex) / count;
	return vec3(cos(theta) * r, weight, sin(theta) * r);
}
float noise(vec2 screenPos) {
	const float PHI = 1.61803398874989484820459;
	return fract(sin(dot(screenPos * PHI, screenPos)) * screenPos.x);
}
float viewSpaceDepth(float depth, mat4 invProjection) {
	float z = depth * 2.0 - 1.0;
	vec4 clipSpace = vec4(0.0, 0.0, z, 1.0);
	vec4 viewSpace = invProjection * clipSpace;
	return viewSpace.z;
}
float PCSSBlockerDistance(TEXTURE_ACCEPT(shadowMap), vec2 sampleCoords[PCSS_SAMPLE_COUNT], vec2 shadowCoords, vec2 searchSize, float z, vec4 cameraParams) {
	float blockers = 0.0;
	float averageBlocker = 0.0;
	for (int i = 0; i < PCSS_SAMPLE_COUNT; i++) {
		vec2 offset = sampleCoords[i] * searchSize;
		vec2 sampleUV = shadowCoords + offset;
		float blocker = texture2DLod(shadowMap, sampleUV, 0.0).r;
		float isBlocking = step(blocker, z);
		blockers += isBlocking;
		averageBlocker += blocker * isBlocking;
	}
	if (blockers > 0.0)
		return averageBlocker / blockers;
	return -1.0;
}
float PCSS(TEXTURE_ACCEPT(shadowMap), vec3 shadowCoords, vec4 cameraParams, vec2 shadowSearchArea) {
	float receiverDepth = linearizeDepthWithParams(shadowCoords.z, cameraParams);
	vec2 samplePoints[PCSS_SAMPLE_COUNT];
	const float PI = 3.141592653589793;
	float noise = noise( gl_FragCoord.xy ) * 2.0 * PI;
	for (int i = 0; i < PCSS_SAMPLE_COUNT; i++) {
		float pcssPresample = pcssDiskSamples[i];
		samplePoints[i] = vogelDisk(i, float(PCSS_SAMPLE_COUNT), noise, pcssPresample);
	}
	float averageBlocker = PCSSBlockerDistance(TEXTURE_PASS(shadowMap), samplePoints, shadowCoords.xy, shadowSearchArea, receiverDepth, cameraParams);
	if (averageBlocker == -1.0) {
		return 1.0;
	} else {
		float depthDifference = (receiverDepth - averageBlocker) / 3.0;
		vec2 filterRadius = depthDifference * shadowSearchArea;
		float shadow = 0.0;
		for (int i = 0; i < PCSS_SAMPLE_COUNT; i ++)
		{
			vec2 sampleUV = samplePoints[i] * filterRadius;
			sampleUV = shadowCoords.xy + sampleUV;
			float depth = texture2DLod(shadowMap, sampleUV, 0.0).r;
			shadow += step(receiverDepth, depth);
		}
		return shadow / float(PCSS_SAMPLE_COUNT);
	} 
}
#ifndef WEBGPU
float PCSSCubeBlockerDistance(samplerCube shadowMap, vec3 lightDirNorm, vec3 samplePoints[PCSS_SAMPLE_COUNT], float z, float shadowSearchArea) {
	float blockers = 0.0;
	float averageBlocker = 0.0;
	for (int i = 0; i < PCSS_SAMPLE_COUNT; i++) {
		vec3 sampleDir = lightDirNorm + samplePoints[i] * shadowSearchArea;
		sampleDir = normalize(sampleDir);
		float blocker = textureCubeLod(shadowMap, sampleDir, 0.0).r;
		float isBlocking = step(blocker, z);
		blockers += isBlocking;
		averageBlocker += blocker * isBlocking;
	}
	if (blockers > 0.0)
		return averageBlocker / blockers;
	return -1.0;
}
float PCSSCube(samplerCube shadowMap, vec4 shadowParams, vec3 shadowCoords, vec4 cameraParams, float shadowSearchArea, vec3 lightDir) {
	
	vec3 samplePoints[PCSS_SAMPLE_COUNT];
	const float PI = 3.141592653589793;
	float noise = noise( gl_FragCoord.xy ) * 2.0 * PI;
	for (int i = 0; i < PCSS_SAMPLE_COUNT; i++) {
		float r = pcssSphereSamples[i];
		samplePoints[i] = vogelSphere(i, float(PCSS_SAMPLE_COUNT), noise, r);
	}
	float receiverDepth = length(lightDir) * shadowParams.w + shadowParams.z;
	vec3 lightDirNorm = normalize(lightDir);
	
	float averageBlocker = PCSSCubeBlockerDistance(shadowMap, lightDirNorm, samplePoints, receiverDepth, shadowSearchArea);
	if (averageBlocker == -1.0) {
		return 1.0;
	} else {
		float filterRadius = ((receiverDepth - averageBlocker) / averageBlocker) * shadowSearchArea;
		float shadow = 0.0;
		for (int i = 0; i < PCSS_SAMPLE_COUNT; i++)
		{
			vec3 offset = samplePoints[i] * filterRadius;
			vec3 sampleDir = lightDirNorm + offset;
			sampleDir = normalize(sampleDir);
			float depth = textureCubeLod(shadowMap, sampleDir, 0.0).r;
			shadow += step(receiverDepth, depth);
		}
		return shadow / float(PCSS_SAMPLE_COUNT);
	}
}
float getShadowOmniPCSS(samplerCube shadowMap, vec3 shadowCoord, vec4 shadowParams, vec4 cameraParams, vec2 shadowSearchArea, vec3 lightDir) {
	return PCSSCube(shadowMap, shadowParams, shadowCoord, cameraParams, shadowSearchArea.x, lightDir);
}
#endif
float getShadowSpotPCSS(TEXTURE_ACCEPT(shadowMap), vec3 shadowCoord, vec4 shadowParams, vec4 cameraParams, vec2 shadowSearchArea, vec3 lightDir) {
	return PCSS(TEXTURE_PASS(shadowMap), shadowCoord, cameraParams, shadowSearchArea);
}
`;var Ky=`
highp float fractSinRand(const in vec2 uv) {
	const float PI = 3.141592653589793;
	const highp float a = 12.9898, b = 78.233, c = 43758.5453;
	highp float dt = dot(uv.xy, vec2(a, b)), sn = mod(dt, PI);
	return fract(sin(sn) * c);
}
struct VogelDiskData {
	float invNumSamples;
	float initialAngle;
	float currentPointId;
};
void prepareDiskConstants(out VogelDiskData data, int sampleCount, float randomSeed) {
	const float pi2 = 6.28318530718;
	data.invNumSamples = 1.0 / float(sampleCount);
	data.initialAngle = randomSeed * pi2;
	data.currentPointId = 0.0;
}
vec2 generateDiskSample(inout VogelDiskData data) {
	const float GOLDEN_ANGLE = 2.399963;
	float r = sqrt((data.currentPointId + 0.5) * data.invNumSamples);
	float theta = data.currentPointId * GOLDEN_ANGLE + data.initialAngle;
	vec2 offset = vec2(cos(theta), sin(theta)) * pow(r, 1.33);
	data.currentPointId += 1.0;
	return offset;
}
void PCSSFindBlocker(TEXTURE_ACCEPT(shadowMap), out float avgBlockerDepth, out int numBlockers,
	vec2 shadowCoords, float z, int shadowBlockerSamples, float searchWidthUv, float randomSeed) {
	VogelDiskData diskData;
	prepareDiskConstants(diskData, shadowBlockerSamples, randomSeed);
	float blockerSum = 0.0;
	numBlockers = 0;
	for( int i = 0; i < shadowBlockerSamples; ++i ) {
		vec2 diskUV = generateDiskSample(diskData);
		vec2 sampleUV = shadowCoords + diskUV * searchWidthUv;
		float shadowMapDepth = texture2DLod(shadowMap, sampleUV, 0.0).r;
		if ( shadowMapDepth < z ) {
			blockerSum += shadowMapDepth;
			numBlockers++;
		}
	}
	avgBlockerDepth = blockerSum / float(numBlockers);
}
float PCSSFilter(TEXTURE_ACCEPT(shadowMap), vec2 uv, float receiverDepth, int shadowSamples, float filterRadius, float randomSeed) {
	VogelDiskData diskData;
	prepareDiskConstants(diskData, shadowSamples, randomSeed);
	float sum = 0.0;
	for (int i = 0; i < shadowSamples; i++) {
		vec2 offsetUV = generateDiskSample(diskData) * filterRadius;
		float depth = texture2DLod(shadowMap, uv + offsetUV, 0.0).r;
		sum += step(receiverDepth, depth);
	}
	return sum / float(shadowSamples);
}
float PCSSDirectional(TEXTURE_ACCEPT(shadowMap), vec3 shadowCoords, vec4 cameraParams, vec4 softShadowParams) {
	float receiverDepth = shadowCoords.z;
	float receiverDepthClamped = min(receiverDepth, 0.9999);
	float randomSeed = fractSinRand(gl_FragCoord.xy);
	int shadowSamples = int(softShadowParams.x);
	int shadowBlockerSamples = int(softShadowParams.y);
	float penumbraSize = softShadowParams.z;
	float penumbraFalloff = softShadowParams.w;
	float orthoRadius = cameraParams.x;
	float depthRange = cameraParams.y - cameraParams.z;
	float worldPerUv = 2.0 * orthoRadius;
	float filterRadius;
	if (shadowBlockerSamples > 0) {
		float searchWidthUv = (penumbraSize * depthRange) / worldPerUv;
		float avgBlockerDepth = 0.0;
		int numBlockers = 0;
		PCSSFindBlocker(TEXTURE_PASS(shadowMap), avgBlockerDepth, numBlockers, shadowCoords.xy, receiverDepthClamped, shadowBlockerSamples, searchWidthUv, randomSeed);
		if (numBlockers < 1)
			return 1.0f;
		float worldDist = max((receiverDepth - avgBlockerDepth) * depthRange, 0.0);
		float t = clamp(worldDist / depthRange, 0.0, 1.0);
		float shape = 1.0 - pow(1.0 - t, penumbraFalloff);
		float penumbraWorld = shape * penumbraSize * depthRange;
		filterRadius = penumbraWorld / worldPerUv;
	} else {
		filterRadius = penumbraSize / worldPerUv;
	}
	return PCSSFilter(TEXTURE_PASS(shadowMap), shadowCoords.xy, receiverDepthClamped, shadowSamples, filterRadius, randomSeed);
}
float getShadowPCSS(TEXTURE_ACCEPT(shadowMap), vec3 shadowCoord, vec4 shadowParams, vec4 cameraParams, vec4 softShadowParams, vec3 lightDir) {
	return PCSSDirectional(TEXTURE_PASS(shadowMap), shadowCoord, cameraParams, softShadowParams);
}
`;var Zy=`
attribute float vertex_boneIndices;
uniform highp sampler2D texture_poseMap;
mat4 getBoneMatrix(const in float indexFloat) {
	int width = textureSize(texture_poseMap, 0).x;
	int index = int(indexFloat + 0.5) * 3;
	int iy = index / width;
	int ix = index % width;
	vec4 v1 = texelFetch(texture_poseMap, ivec2(ix + 0, iy), 0);
	vec4 v2 = texelFetch(texture_poseMap, ivec2(ix + 1, iy), 0);
	vec4 v3 = texelFetch(texture_poseMap, ivec2(ix + 2, iy), 0);
	return mat4(
		v1.x, v2.x, v3.x, 0,
		v1.y, v2.y, v3.y, 0,
		v1.z, v2.z, v3.z, 0,
		v1.w, v2.w, v3.w, 1
	);
}
`;var Qy=`
attribute vec4 vertex_boneWeights;
attribute vec4 vertex_boneIndices;
uniform highp sampler2D texture_poseMap;
void getBoneMatrix(const in int width, const in int index, out vec4 v1, out vec4 v2, out vec4 v3) {
	int v = index / width;
	int u = index % width;
	v1 = texelFetch(texture_poseMap, ivec2(u + 0, v), 0);
	v2 = texelFetch(texture_poseMap, ivec2(u + 1, v), 0);
	v3 = texelFetch(texture_poseMap, ivec2(u + 2, v), 0);
}
mat4 getSkinMatrix(const in vec4 indicesFloat, const in vec4 weights) {
	int width = textureSize(texture_poseMap, 0).x;
	ivec4 indices = ivec4(indicesFloat + 0.5) * 3;
	vec4 a1, a2, a3;
	getBoneMatrix(width, indices.x, a1, a2, a3);
	vec4 b1, b2, b3;
	getBoneMatrix(width, indices.y, b1, b2, b3);
	vec4 c1, c2, c3;
	getBoneMatrix(width, indices.z, c1, c2, c3);
	vec4 d1, d2, d3;
	getBoneMatrix(width, indices.w, d1, d2, d3);
	vec4 v1 = a1 * weights.x + b1 * weights.y + c1 * weights.z + d1 * weights.w;
	vec4 v2 = a2 * weights.x + b2 * weights.y + c2 * weights.z + d2 * weights.w;
	vec4 v3 = a3 * weights.x + b3 * weights.y + c3 * weights.z + d3 * weights.w;
	float one = dot(weights, vec4(1.0));
	return mat4(
		v1.x, v2.x, v3.x, 0,
		v1.y, v2.y, v3.y, 0,
		v1.z, v2.z, v3.z, 0,
		v1.w, v2.w, v3.w, one
	);
}
`;var Jy=`
	#define LIT_SKYBOX_INTENSITY
	#include "envProcPS"
	#include "gammaPS"
	#include "tonemappingPS"
	#include "sceneTexturesPS"
	#if defined(PREPASS_PASS) || (defined(SCENE_TEXTURE_DEPTH) && defined(SKYMESH))
		varying float vLinearDepth;
	#endif
	#ifdef PREPASS_PASS
		#include "floatAsUintPS"
	#endif
	varying vec3 vViewDir;
	uniform float skyboxHighlightMultiplier;
	#if defined(SKY_FISHEYE) && !defined(SKYMESH)
		uniform float fisheye_k;
		uniform float fisheye_invK;
		uniform float fisheye_projMat00;
		uniform float fisheye_projMat11;
		uniform mat4 matrix_view;
		uniform mat3 cubeMapRotationMatrix;
		varying vec3 vClipXYW;
	#endif
	#ifdef SKY_CUBEMAP
		uniform samplerCube texture_cubeMap;
		#ifdef SKYMESH
			varying vec3 vWorldPos;
			uniform mat3 cubeMapRotationMatrix;
			uniform vec3 projectedSkydomeCenter;
		#endif
	#else
		#include "sphericalPS"
		#include "envAtlasPS"
		uniform sampler2D texture_envAtlas;
		uniform float mipLevel;
	#endif
	void main(void) {
		#ifdef PREPASS_PASS
			gl_FragColor = float2vec4(vLinearDepth);
		#else
			#if defined(SKY_FISHEYE) && !defined(SKYMESH)
				vec2 ndc = vClipXYW.xy / vClipXYW.z;
				float px = ndc.x / fisheye_projMat00;
				float py = ndc.y / fisheye_projMat11;
				float r = sqrt(px * px + py * py);
				float theta = fisheye_k * atan(r * fisheye_invK);
				float sinT = sin(theta);
				float cosT = cos(theta);
				vec3 camDir = (r > 1e-6)
					? vec3(px / r * sinT, py / r * sinT, -cosT)
					: vec3(0.0, 0.0, -1.0);
				vec3 dir = transpose(mat3(matrix_view)) * camDir;
				dir = dir * cubeMapRotationMatrix;
			#elif defined(SKY_CUBEMAP) && defined(SKYMESH)
				vec3 envDir = normalize(vWorldPos - projectedSkydomeCenter);
				vec3 dir = envDir * cubeMapRotationMatrix;
			#else
				vec3 dir = vViewDir;
			#endif
			#ifdef SKY_CUBEMAP
				dir.x *= -1.0;
				vec3 linear = {SKYBOX_DECODE_FNC}(textureCube(texture_cubeMap, dir));
			#else
				dir *= vec3(-1.0, 1.0, 1.0);
				vec2 uv = toSphericalUv(normalize(dir));
				vec3 linear = {SKYBOX_DECODE_FNC}(texture2D(texture_envAtlas, mapRoughnessUv(uv, mipLevel)));
			#endif
			if (any(greaterThanEqual(linear, vec3(64.0)))) {
				linear *= skyboxHighlightMultiplier;
			}
			gl_FragColor = vec4(gammaCorrectOutput(toneMap(processEnvironment(linear))), 1.0);
			#if defined(SCENE_TEXTURE_DEPTH) && defined(SKYMESH)
				writeSceneTextureDepth(vLinearDepth, 1.0);
			#endif
		#endif
	}
`;var eC=`
attribute vec4 aPosition;
uniform mat4 matrix_view;
uniform mat4 matrix_projectionSkybox;
uniform mat3 cubeMapRotationMatrix;
varying vec3 vViewDir;
#ifdef SKY_FISHEYE
	varying vec3 vClipXYW;
	uniform float projectionFlipY;
#endif
#if defined(PREPASS_PASS) || (defined(SCENE_TEXTURE_DEPTH) && defined(SKYMESH))
	varying float vLinearDepth;
#endif
#ifdef SKYMESH
	uniform mat4 matrix_model;
	varying vec3 vWorldPos;
#endif
void main(void) {
	mat4 view = matrix_view;
	#ifdef SKYMESH
		vec4 worldPos = matrix_model * aPosition;
		vWorldPos = worldPos.xyz;
		gl_Position = matrix_projectionSkybox * (view * worldPos);
		#if defined(PREPASS_PASS) || defined(SCENE_TEXTURE_DEPTH)
			vLinearDepth = -(matrix_view * vec4(vWorldPos, 1.0)).z;
		#endif
	#else
		view[3][0] = view[3][1] = view[3][2] = 0.0;
		vViewDir = aPosition.xyz * cubeMapRotationMatrix;
		#ifdef SKY_FISHEYE
			vec4 viewPos = view * aPosition;
			vClipXYW = vec3(viewPos.xy, -viewPos.z);
			gl_Position = vec4(viewPos.x, viewPos.y * projectionFlipY, 0.0, -viewPos.z);
		#else
			gl_Position = matrix_projectionSkybox * (view * aPosition);
		#endif
		#ifdef PREPASS_PASS
			vLinearDepth = -gl_Position.w;
		#endif
	#endif
	gl_Position.z = gl_Position.w - 1.0e-7;
}
`;var tC=`
#ifdef STD_SPECULAR_CONSTANT
uniform vec3 material_specular;
#endif
void getSpecularity() {
	vec3 specularColor = vec3(1,1,1);
	#ifdef STD_SPECULAR_CONSTANT
	specularColor *= material_specular;
	#endif
	#ifdef STD_SPECULAR_TEXTURE
	specularColor *= {STD_SPECULAR_TEXTURE_DECODE}(texture2DBias({STD_SPECULAR_TEXTURE_NAME}, {STD_SPECULAR_TEXTURE_UV}, {STD_TEXTURE_BIAS})).{STD_SPECULAR_TEXTURE_CHANNEL};
	#endif
	#ifdef STD_SPECULAR_VERTEX
	specularColor *= saturate(vVertexColor.{STD_SPECULAR_VERTEX_CHANNEL});
	#endif
	dSpecularity = specularColor;
}
`;var sC=`
vec2 toSpherical(vec3 dir) {
	return vec2(dir.xz == vec2(0.0) ? 0.0 : atan(dir.x, dir.z), asin(dir.y));
}
vec2 toSphericalUv(vec3 dir) {
	const float PI = 3.141592653589793;
	vec2 uv = toSpherical(dir) / vec2(PI * 2.0, PI) + 0.5;
	return vec2(uv.x, 1.0 - uv.y);
}
`;var rC=`
#ifdef STD_SPECULARITYFACTOR_CONSTANT
uniform float material_specularityFactor;
#endif
void getSpecularityFactor() {
	float specularityFactor = 1.0;
	#ifdef STD_SPECULARITYFACTOR_CONSTANT
	specularityFactor *= material_specularityFactor;
	#endif
	#ifdef STD_SPECULARITYFACTOR_TEXTURE
	specularityFactor *= texture2DBias({STD_SPECULARITYFACTOR_TEXTURE_NAME}, {STD_SPECULARITYFACTOR_TEXTURE_UV}, {STD_TEXTURE_BIAS}).{STD_SPECULARITYFACTOR_TEXTURE_CHANNEL};
	#endif
	#ifdef STD_SPECULARITYFACTOR_VERTEX
	specularityFactor *= saturate(vVertexColor.{STD_SPECULARITYFACTOR_VERTEX_CHANNEL});
	#endif
	dSpecularityFactor = specularityFactor;
}
`;var iC=`
float getSpotEffect(vec3 lightSpotDir, float lightInnerConeAngle, float lightOuterConeAngle, vec3 lightDirNorm) {
	float cosAngle = dot(lightDirNorm, lightSpotDir);
	return smoothstep(lightOuterConeAngle, lightInnerConeAngle, cosAngle);
}
`;var aC=`
	nineSlicedUv = vec2(vUv0.x, 1.0 - vUv0.y);
`;var oC=`
	vec2 tileMask = step(vMask, vec2(0.99999));
	vec2 tileSize = 0.5 * (innerOffset.xy + innerOffset.zw);
	vec2 tileScale = vec2(1.0) / (vec2(1.0) - tileSize);
	vec2 clampedUv = mix(innerOffset.xy * 0.5, vec2(1.0) - innerOffset.zw * 0.5, fract((vTiledUv - tileSize) * tileScale));
	clampedUv = clampedUv * atlasRect.zw + atlasRect.xy;
	nineSlicedUv = vUv0 * tileMask + clampedUv * (vec2(1.0) - tileMask);
	nineSlicedUv.y = 1.0 - nineSlicedUv.y;
	
`;var nC=`
	#ifdef MESH_COLOR
		uniform vec4 mesh_color;
	#endif
	float dAlpha = 1.0;
	#if LIT_BLEND_TYPE != NONE || defined(LIT_ALPHA_TEST) || defined(LIT_ALPHA_TO_COVERAGE) || STD_OPACITY_DITHER != NONE
		#ifdef STD_OPACITY_TEXTURE_ALLOCATE
			uniform sampler2D texture_opacityMap;
		#endif
	#endif
	#ifdef FORWARD_PASS
		vec3 dAlbedo;
		vec3 dNormalW;
		vec3 dSpecularity = vec3(0.0);
		float dGlossiness = 0.0;
		uniform vec3 material_ambient;
		#ifdef LIT_REFRACTION
			float dTransmission;
			float dThickness;
			#ifndef LIT_METALNESS
				float dIor;
			#endif
		#endif
		#ifdef LIT_SCENE_COLOR
			uniform sampler2D uSceneColorMap;
		#endif
		#ifdef LIT_SCREEN_SIZE
			uniform vec4 screen_size;
		#endif
		#ifdef LIT_TRANSFORMS
			uniform mat4 matrix_viewProjection;
		#endif
		#ifdef STD_HEIGHT_MAP
			vec2 dUvOffset;
			#ifdef STD_PARALLAX_SELF_SHADOW
				float dParallaxHitDepth;
				float dParallaxLod;
			#endif
			#ifdef STD_HEIGHT_TEXTURE_ALLOCATE
				uniform sampler2D texture_heightMap;
			#endif
		#endif
		#ifdef STD_DIFFUSE_TEXTURE_ALLOCATE
			uniform sampler2D texture_diffuseMap;
		#endif
		#ifdef STD_DIFFUSEDETAIL_TEXTURE_ALLOCATE
			uniform sampler2D texture_diffuseDetailMap;
		#endif
		#ifdef STD_NORMAL_TEXTURE_ALLOCATE
			uniform sampler2D texture_normalMap;
		#endif
		#ifdef STD_NORMALDETAIL_TEXTURE_ALLOCATE
			uniform sampler2D texture_normalDetailMap;
		#endif
		#ifdef STD_THICKNESS_TEXTURE_ALLOCATE
			uniform sampler2D texture_thicknessMap;
		#endif
		#ifdef STD_REFRACTION_TEXTURE_ALLOCATE
			uniform sampler2D texture_refractionMap;
		#endif
		#ifdef LIT_IRIDESCENCE
			float dIridescence;
			float dIridescenceThickness;
			#ifdef STD_IRIDESCENCE_THICKNESS_TEXTURE_ALLOCATE
				uniform sampler2D texture_iridescenceThicknessMap;
			#endif
			#ifdef STD_IRIDESCENCE_TEXTURE_ALLOCATE
				uniform sampler2D texture_iridescenceMap;
			#endif
		#endif
		#ifdef LIT_CLEARCOAT
			float ccSpecularity;
			float ccGlossiness;
			vec3 ccNormalW;
		#endif
		#ifdef LIT_GGX_SPECULAR
			float dAnisotropy;
			vec2 dAnisotropyRotation;
		#endif
		#if defined(LIT_SPECULAR_OR_REFLECTION) || defined(LIT_REFRACTION)
			#ifdef LIT_SHEEN
				vec3 sSpecularity;
				float sGlossiness;
				#ifdef STD_SHEEN_TEXTURE_ALLOCATE
					uniform sampler2D texture_sheenMap;
				#endif
				#ifdef STD_SHEENGLOSS_TEXTURE_ALLOCATE
					uniform sampler2D texture_sheenGlossMap;
				#endif
			#endif
			#ifdef LIT_METALNESS
				float dMetalness;
				float dIor;
				#ifdef STD_METALNESS_TEXTURE_ALLOCATE
					uniform sampler2D texture_metalnessMap;
				#endif
			#endif
			#ifdef LIT_SPECULARITY_FACTOR
				float dSpecularityFactor;
				#ifdef STD_SPECULARITYFACTOR_TEXTURE_ALLOCATE
					uniform sampler2D texture_specularityFactorMap;
				#endif
			#endif
			#ifdef STD_SPECULAR_COLOR
				#ifdef STD_SPECULAR_TEXTURE_ALLOCATE
					uniform sampler2D texture_specularMap;
				#endif
			#endif
			#ifdef STD_GLOSS_TEXTURE_ALLOCATE
				uniform sampler2D texture_glossMap;
			#endif
		#endif
		#ifdef STD_AO
			float dAo;
			#ifdef STD_AO_TEXTURE_ALLOCATE
				uniform sampler2D texture_aoMap;
			#endif
			#ifdef STD_AODETAIL_TEXTURE_ALLOCATE
				uniform sampler2D texture_aoDetailMap;
			#endif
		#endif
		vec3 dEmission;
		#ifdef STD_EMISSIVE_TEXTURE_ALLOCATE
			uniform sampler2D texture_emissiveMap;
		#endif
		#ifdef LIT_CLEARCOAT
			#ifdef STD_CLEARCOAT_TEXTURE_ALLOCATE
				uniform sampler2D texture_clearCoatMap;
			#endif
			#ifdef STD_CLEARCOATGLOSS_TEXTURE_ALLOCATE
				uniform sampler2D texture_clearCoatGlossMap;
			#endif
			#ifdef STD_CLEARCOATNORMAL_TEXTURE_ALLOCATE
				uniform sampler2D texture_clearCoatNormalMap;
			#endif
		#endif
		
		#ifdef LIT_GGX_SPECULAR
			#ifdef STD_ANISOTROPY_TEXTURE_ALLOCATE
				uniform sampler2D texture_anisotropyMap;
			#endif
		#endif
		#if defined(STD_LIGHTMAP) || defined(STD_LIGHT_VERTEX_COLOR)
			vec3 dLightmap;
			#ifdef STD_LIGHT_TEXTURE_ALLOCATE
				uniform sampler2D {STD_LIGHT_TEXTURE_NAME};
			#endif
		#endif
	#endif
	#include "litShaderCorePS"
`;var lC=`
	#if defined(FORWARD_PASS) && defined(STD_HEIGHT_MAP)
		#include "parallaxPS"
	#endif
	#if LIT_BLEND_TYPE != NONE || defined(LIT_ALPHA_TEST) || defined(LIT_ALPHA_TO_COVERAGE) || STD_OPACITY_DITHER != NONE
		#include "opacityPS"
		#if defined(LIT_ALPHA_TEST)
			#include "alphaTestPS"
		#endif
		#if STD_OPACITY_DITHER != NONE
			#include "opacityDitherPS"
		#endif
	#endif
	#ifdef FORWARD_PASS
		#include  "diffusePS"
		#ifdef LIT_NEEDS_NORMAL
			#include "normalMapPS"
		#endif
		#ifdef LIT_REFRACTION
			#include "transmissionPS"
			#include "thicknessPS"
			#ifndef LIT_METALNESS
				#include "iorPS"
			#endif
		#endif
		#ifdef LIT_IRIDESCENCE
			#include "iridescencePS"
			#include "iridescenceThicknessPS"
		#endif
		#if defined(LIT_SPECULAR_OR_REFLECTION) || defined(LIT_REFRACTION)
			#ifdef LIT_SHEEN
				#include "sheenPS"
				#include "sheenGlossPS"
			#endif
			#ifdef LIT_METALNESS
				#include "metalnessPS"
				#include "iorPS"
			#endif
			#ifdef LIT_SPECULARITY_FACTOR
				#include "specularityFactorPS"
			#endif
			#ifdef STD_SPECULAR_COLOR
				#include "specularPS"
			#else
				void getSpecularity() { 
					dSpecularity = vec3(1);
				}
			#endif
			#include "glossPS"
		#endif
		#ifdef STD_AO
			#include "aoPS"
		#endif
		#include "emissivePS"
		#ifdef LIT_CLEARCOAT
			#include "clearCoatPS"
			#include "clearCoatGlossPS"
			#include "clearCoatNormalPS"
		#endif
		#if defined(LIT_SPECULAR) && defined(LIT_LIGHTING) && defined(LIT_GGX_SPECULAR)
			#include "anisotropyPS"
		#endif
		#if defined(STD_LIGHTMAP) || defined(STD_LIGHT_VERTEX_COLOR)
			#include "lightmapPS"
		#endif
	#endif
	void evaluateFrontend() {
		#if defined(FORWARD_PASS) && defined(STD_HEIGHT_MAP)
			getParallax();
		#endif
		#if LIT_BLEND_TYPE != NONE || defined(LIT_ALPHA_TEST) || defined(LIT_ALPHA_TO_COVERAGE) || STD_OPACITY_DITHER != NONE
			getOpacity();
			#if defined(LIT_ALPHA_TEST)
				alphaTest(dAlpha);
			#endif
			#if STD_OPACITY_DITHER != NONE
				opacityDither(dAlpha * material_alphaDitherScale, 0.0);
			#endif
			litArgs_opacity = dAlpha;
		#endif
		#ifdef FORWARD_PASS
			getAlbedo();
			litArgs_albedo = dAlbedo;
			litArgs_ambient = material_ambient;
			#ifdef LIT_NEEDS_NORMAL
				getNormal();
				litArgs_worldNormal = dNormalW;
			#endif
			#ifdef LIT_REFRACTION
				getRefraction();
				litArgs_transmission = dTransmission;
				getThickness();
				litArgs_thickness = dThickness;
				#ifndef LIT_METALNESS
					getIor();
					litArgs_ior = dIor;
				#endif
				#ifdef LIT_DISPERSION
					litArgs_dispersion = material_dispersion;
				#endif
			#endif
			#ifdef LIT_IRIDESCENCE
				getIridescence();
				getIridescenceThickness();
				litArgs_iridescence_intensity = dIridescence;
				litArgs_iridescence_thickness = dIridescenceThickness;
			#endif
			#if defined(LIT_SPECULAR_OR_REFLECTION) || defined(LIT_REFRACTION)
				#ifdef LIT_SHEEN
					getSheen();
					litArgs_sheen_specularity = sSpecularity;
					getSheenGlossiness();
					litArgs_sheen_gloss = sGlossiness;
				#endif
				#ifdef LIT_METALNESS
					getMetalness();
					litArgs_metalness = dMetalness;
					getIor();
					litArgs_ior = dIor;
				#endif
				#ifdef LIT_SPECULARITY_FACTOR
					getSpecularityFactor();
					litArgs_specularityFactor = dSpecularityFactor;
				#endif
				getGlossiness();
				getSpecularity();
				litArgs_specularity = dSpecularity;
				litArgs_gloss = dGlossiness;
			#endif
			#ifdef STD_AO
				getAO();
				litArgs_ao = dAo;
			#endif
			getEmission();
			litArgs_emission = dEmission;
			#ifdef LIT_CLEARCOAT
				getClearCoat();
				getClearCoatGlossiness();
				getClearCoatNormal();
				litArgs_clearcoat_specularity = ccSpecularity;
				litArgs_clearcoat_gloss = ccGlossiness;
				litArgs_clearcoat_worldNormal = ccNormalW;
			#endif
			#if defined(LIT_SPECULAR) && defined(LIT_LIGHTING) && defined(LIT_GGX_SPECULAR)
				getAnisotropy();
			#endif
			#if defined(STD_LIGHTMAP) || defined(STD_LIGHT_VERTEX_COLOR)
				getLightMap();
				litArgs_lightmap = dLightmap;
				#ifdef STD_LIGHTMAP_DIR
					litArgs_lightmapDir = dLightmapDir;
				#endif
			#endif
		#endif
	}
`;var cC=`
#ifdef LIT_TANGENTS
	#define TBN_TANGENTS
#else
	#if defined(LIT_USE_NORMALS) || defined(LIT_USE_CLEARCOAT_NORMALS) || defined(LIT_HEIGHTS)
		#define TBN_DERIVATIVES
	#endif
#endif
#if defined(TBN_DERIVATIVES)
	#ifndef TBNBASIS
		#define TBNBASIS
		uniform float tbnBasis;
	#endif
#endif
void getTBN(vec3 tangent, vec3 binormal, vec3 normal) {
	#ifdef TBN_TANGENTS
		dTBN = mat3(normalize(tangent), normalize(binormal), normalize(normal));
	#elif defined(TBN_DERIVATIVES)
		vec2 uv = {lightingUv};
		vec3 dp1 = dFdx( vPositionW );
		vec3 dp2 = dFdy( vPositionW );
		vec2 duv1 = dFdx( uv );
		vec2 duv2 = dFdy( uv );
		vec3 dp2perp = cross( dp2, normal );
		vec3 dp1perp = cross( normal, dp1 );
		vec3 T = dp2perp * duv1.x + dp1perp * duv2.x;
		vec3 B = dp2perp * duv1.y + dp1perp * duv2.y;
		float denom = max( dot(T,T), dot(B,B) );
		float invmax = (denom == 0.0) ? 0.0 : tbnBasis / sqrt( denom );
		dTBN = mat3(T * invmax, -B * invmax, normal );
	#else
		vec3 B = cross(normal, vObjectSpaceUpW);
		vec3 T = cross(normal, B);
		if (dot(B,B)==0.0)
		{
			float major=max(max(normal.x, normal.y), normal.z);
			if (normal.x == major)
			{
				B = cross(normal, vec3(0,1,0));
				T = cross(normal, B);
			}
			else if (normal.y == major)
			{
				B = cross(normal, vec3(0,0,1));
				T = cross(normal, B);
			}
			else if (normal.z == major)
			{
				B = cross(normal, vec3(1,0,0));
				T = cross(normal, B);
			}
		}
		dTBN = mat3(normalize(T), normalize(B), normalize(normal));
	#endif
}
`;var hC=`
#ifdef STD_THICKNESS_CONSTANT
uniform float material_thickness;
#endif
void getThickness() {
	dThickness = 1.0;
	#ifdef STD_THICKNESS_CONSTANT
	dThickness *= material_thickness;
	#endif
	#ifdef STD_THICKNESS_TEXTURE
	dThickness *= texture2DBias({STD_THICKNESS_TEXTURE_NAME}, {STD_THICKNESS_TEXTURE_UV}, {STD_TEXTURE_BIAS}).{STD_THICKNESS_TEXTURE_CHANNEL};
	#endif
	#ifdef STD_THICKNESS_VERTEX
	dThickness *= saturate(vVertexColor.{STD_THICKNESS_VERTEX_CHANNEL});
	#endif
}
`;var dC=`
#ifndef TONEMAP_NO_EXPOSURE_UNIFORM
	#if TONEMAP != NONE
		uniform float exposure;
		float getExposure() { return exposure; }
	#else
		float getExposure() { return 1.0; }
	#endif
#endif
#if (TONEMAP == NONE)
	#include "tonemappingNonePS"
#elif TONEMAP == FILMIC
	#include "tonemappingFilmicPS"
#elif TONEMAP == LINEAR
	#include "tonemappingLinearPS"
#elif TONEMAP == HEJL
	#include "tonemappingHejlPS"
#elif TONEMAP == ACES
	#include "tonemappingAcesPS"
#elif TONEMAP == ACES2
	#include "tonemappingAces2PS"
#elif TONEMAP == NEUTRAL
	#include "tonemappingNeutralPS"
#endif
`;var fC=`
vec3 toneMap(vec3 color) {
	float tA = 2.51;
	float tB = 0.03;
	float tC = 2.43;
	float tD = 0.59;
	float tE = 0.14;
	vec3 x = color * getExposure();
	return (x*(tA*x+tB))/(x*(tC*x+tD)+tE);
}
`;var uC=`
const mat3 ACESInputMat = mat3(
	0.59719, 0.35458, 0.04823,
	0.07600, 0.90834, 0.01566,
	0.02840, 0.13383, 0.83777
);
const mat3 ACESOutputMat = mat3(
	 1.60475, -0.53108, -0.07367,
	-0.10208,  1.10813, -0.00605,
	-0.00327, -0.07276,  1.07602
);
vec3 RRTAndODTFit(vec3 v) {
	vec3 a = v * (v + 0.0245786) - 0.000090537;
	vec3 b = v * (0.983729 * v + 0.4329510) + 0.238081;
	return a / b;
}
vec3 toneMap(vec3 color) {
	color *= getExposure() / 0.6;
	color = color * ACESInputMat;
	color = RRTAndODTFit(color);
	color = color * ACESOutputMat;
	color = clamp(color, 0.0, 1.0);
	return color;
}
`;var mC=`
const float A =  0.15;
const float B =  0.50;
const float C =  0.10;
const float D =  0.20;
const float E =  0.02;
const float F =  0.30;
const float W =  11.2;
vec3 uncharted2Tonemap(vec3 x) {
	 return ((x*(A*x+C*B)+D*E)/(x*(A*x+B)+D*F))-E/F;
}
vec3 toneMap(vec3 color) {
	color = uncharted2Tonemap(color * getExposure());
	vec3 whiteScale = 1.0 / uncharted2Tonemap(vec3(W,W,W));
	color = color * whiteScale;
	return color;
}
`;var pC=`
vec3 toneMap(vec3 color) {
	color *= getExposure();
	const float  A = 0.22, B = 0.3, C = .1, D = 0.2, E = .01, F = 0.3;
	const float Scl = 1.25;
	vec3 h = max( vec3(0.0), color - vec3(0.004) );
	return (h*((Scl*A)*h+Scl*vec3(C*B,C*B,C*B))+Scl*vec3(D*E,D*E,D*E)) / (h*(A*h+vec3(B,B,B))+vec3(D*F,D*F,D*F)) - Scl*vec3(E/F,E/F,E/F);
}
`;var _C=`
vec3 toneMap(vec3 color) {
	return color * getExposure();
}
`;var gC=`
vec3 toneMap(vec3 color) {
	color *= getExposure();
	float startCompression = 0.8 - 0.04;
	float desaturation = 0.15;
	float x = min(color.r, min(color.g, color.b));
	float offset = x < 0.08 ? x - 6.25 * x * x : 0.04;
	color -= offset;
	float peak = max(color.r, max(color.g, color.b));
	if (peak < startCompression) return color;
	float d = 1. - startCompression;
	float newPeak = 1. - d * d / (peak + d - startCompression);
	color *= newPeak / peak;
	float g = 1. - 1. / (desaturation * (peak - newPeak) + 1.);
	return mix(color, newPeak * vec3(1, 1, 1), g);
}
`;var SC=`
vec3 toneMap(vec3 color) {
	return color;
}
`;var TC=`
#ifdef PIXELSNAP
uniform vec4 screen_size;
#endif
#ifdef SCREENSPACE
uniform float projectionFlipY;
#endif
vec4 evalWorldPosition(vec3 vertexPosition, mat4 modelMatrix) {
	vec3 localPos = getLocalPosition(vertexPosition);
	#ifdef NINESLICED
		localPos.xz *= outerScale;
		vec2 positiveUnitOffset = clamp(vertexPosition.xz, vec2(0.0), vec2(1.0));
		vec2 negativeUnitOffset = clamp(-vertexPosition.xz, vec2(0.0), vec2(1.0));
		localPos.xz += (-positiveUnitOffset * innerOffset.xy + negativeUnitOffset * innerOffset.zw) * vertex_texCoord0.xy;
		vTiledUv = (localPos.xz - outerScale + innerOffset.xy) * -0.5 + 1.0;
		localPos.xz *= -0.5;
		localPos = localPos.xzy;
	#endif
	vec4 posW = modelMatrix * vec4(localPos, 1.0);
	#ifdef SCREENSPACE
		posW.zw = vec2(0.0, 1.0);
	#endif
	return posW;
}
vec4 getPosition() {
	dModelMatrix = getModelMatrix();
	vec4 posW = evalWorldPosition(vertex_position.xyz, dModelMatrix);
	dPositionW = posW.xyz;
	vec4 screenPos;
	#ifdef UV1LAYOUT
		screenPos = vec4(vertex_texCoord1.xy * 2.0 - 1.0, 0.5, 1);
		#ifdef WEBGPU
			screenPos.y *= -1.0;
		#endif
	#else
		#ifdef SCREENSPACE
			screenPos = posW;
			screenPos.y *= projectionFlipY;
		#else
			screenPos = matrix_viewProjection * posW;
		#endif
		#ifdef PIXELSNAP
			screenPos.xy = (screenPos.xy * 0.5) + 0.5;
			screenPos.xy *= screen_size.xy;
			screenPos.xy = floor(screenPos.xy);
			screenPos.xy *= screen_size.zw;
			screenPos.xy = (screenPos.xy * 2.0) - 1.0;
		#endif
	#endif
	return screenPos;
}
vec3 getWorldPosition() {
	return dPositionW;
}
`;var EC=`
attribute vec4 vertex_position;
uniform mat4 matrix_viewProjection;
uniform mat4 matrix_model;
#ifdef MORPHING
	uniform vec2 morph_tex_params;
	attribute uint morph_vertex_id;
	ivec2 getTextureMorphCoords() {
		ivec2 textureSize = ivec2(morph_tex_params);
		int morphGridV = int(morph_vertex_id) / textureSize.x;
		int morphGridU = int(morph_vertex_id) - (morphGridV * textureSize.x);
		#ifdef WEBGPU
			morphGridV = textureSize.y - morphGridV - 1;
		#endif
		return ivec2(morphGridU, morphGridV);
	}
	#ifdef MORPHING_POSITION
		#ifdef MORPHING_INT
			uniform vec3 aabbSize;
			uniform vec3 aabbMin;
			uniform usampler2D morphPositionTex;
		#else
			uniform highp sampler2D morphPositionTex;
		#endif
	#endif
#endif
#ifdef defined(BATCH)
	#include "skinBatchVS"
	mat4 getModelMatrix() {
		return getBoneMatrix(vertex_boneIndices);
	}
#elif defined(SKIN)
	#include "skinVS"
	mat4 getModelMatrix() {
		return matrix_model * getSkinMatrix(vertex_boneIndices, vertex_boneWeights);
	}
#elif defined(INSTANCING)
	#include "transformInstancingVS"
#else
	mat4 getModelMatrix() {
		return matrix_model;
	}
#endif
vec3 getLocalPosition(vec3 vertexPosition) {
	vec3 localPos = vertexPosition;
	#ifdef MORPHING_POSITION
		ivec2 morphUV = getTextureMorphCoords();
		#ifdef MORPHING_INT
			vec3 morphPos = vec3(texelFetch(morphPositionTex, ivec2(morphUV), 0).xyz) / 65535.0 * aabbSize + aabbMin;
		#else
			vec3 morphPos = texelFetch(morphPositionTex, ivec2(morphUV), 0).xyz;
		#endif
		localPos += morphPos;
	#endif
	return localPos;
}
`;var yC=`
attribute vec4 instance_line1;
attribute vec4 instance_line2;
attribute vec4 instance_line3;
attribute vec4 instance_line4;
mat4 getModelMatrix() {
	return matrix_model * mat4(instance_line1, instance_line2, instance_line3, instance_line4);
}
`;var CC=`
#ifdef STD_REFRACTION_CONSTANT
uniform float material_refraction;
#endif
void getRefraction() {
	float refraction = 1.0;
	#ifdef STD_REFRACTION_CONSTANT
	refraction = material_refraction;
	#endif
	#ifdef STD_REFRACTION_TEXTURE
	refraction *= texture2DBias({STD_REFRACTION_TEXTURE_NAME}, {STD_REFRACTION_TEXTURE_UV}, {STD_TEXTURE_BIAS}).{STD_REFRACTION_TEXTURE_CHANNEL};
	#endif
	#ifdef STD_REFRACTION_VERTEX
	refraction *= saturate(vVertexColor.{STD_REFRACTION_VERTEX_CHANNEL});
	#endif
	dTransmission = refraction;
}
`;var vC=`
void handleTwoSidedLighting() {
	if (!gl_FrontFacing) {
		dVertexNormalW = -dVertexNormalW;
		#ifdef LIT_TBN
			dTBN[2] = -dTBN[2];
		#endif
	}
}
`;var xC=`
#ifdef NINESLICED
	vec2 getUv0() {
		vec2 uv = vertex_position.xz;
		vec2 positiveUnitOffset = clamp(vertex_position.xz, vec2(0.0), vec2(1.0));
		vec2 negativeUnitOffset = clamp(-vertex_position.xz, vec2(0.0), vec2(1.0));
		uv += (-positiveUnitOffset * innerOffset.xy + negativeUnitOffset * innerOffset.zw) * vertex_texCoord0.xy;
		uv = uv * -0.5 + 0.5;
		uv = uv * atlasRect.zw + atlasRect.xy;
		vMask = vertex_texCoord0.xy;
		return uv;
	}
#else
	vec2 getUv0() {
		return vertex_texCoord0;
	}
#endif
`;var AC=`
vec2 getUv1() {
	return vertex_texCoord1;
}
`;var RC=`
attribute vec2 vertex_texCoord{UV_SET_{i}};
`;var PC=`
vec2 uv{UV_SET_{i}} = vertex_texCoord{UV_SET_{i}};
`;var DC=`
vUv{UV_VARYING_SET_{i}} = uv{UV_VARYING_SET_{i}};
`;var IC=`
vUV{TRANSFORM_UV_{i}}_{TRANSFORM_ID_{i}} = vec2(
	dot(vec3(uv{TRANSFORM_UV_{i}}, 1), {TRANSFORM_NAME_{i}}0),
	dot(vec3(uv{TRANSFORM_UV_{i}}, 1), {TRANSFORM_NAME_{i}}1)
);
`;var wC=`
	uniform vec3 {TRANSFORM_NAME_{i}}0;
	uniform vec3 {TRANSFORM_NAME_{i}}1;
`;var MC=`
void getViewDir() {
	dViewDirW = normalize(view_position - vPositionW);
}
`;var LC={alphaTestPS:UT,ambientPS:kT,anisotropyPS:GT,aoPS:VT,aoDiffuseOccPS:zT,aoSpecOccPS:HT,bakeDirLmEndPS:WT,bakeLmEndPS:XT,basePS:YT,baseNineSlicedPS:jT,baseNineSlicedTiledPS:qT,bayerPS:$T,blurVSMPS:KT,clearCoatPS:ZT,clearCoatGlossPS:QT,clearCoatNormalPS:JT,clusteredLightCookiesPS:tE,clusteredLightShadowsPS:sE,clusteredLightUtilsPS:eE,clusteredLightPS:rE,combinePS:iE,cookieBlit2DPS:aE,cookieBlitCubePS:oE,cookieBlitVS:nE,cookiePS:lE,cubeMapProjectPS:cE,cubeMapRotatePS:hE,debugOutputPS:dE,debugProcessFrontendPS:fE,detailModesPS:mE,diffusePS:pE,decodePS:uE,emissivePS:_E,encodePS:gE,endPS:SE,envAtlasPS:TE,envProcPS:EE,falloffInvSquaredPS:yE,falloffLinearPS:CE,flatNormalPS:vE,floatAsUintPS:xE,sceneTexturesPS:AE,fogPS:RE,fresnelSchlickPS:PE,frontendCodePS:"",frontendDeclPS:"",fullscreenQuadVS:DE,gammaPS:IE,gles3PS:pc,gles3VS:_c,glossPS:wE,quadVS:ME,immediateLinePS:LE,immediateLineVS:bE,iridescenceDiffractionPS:FE,iridescencePS:OE,iridescenceThicknessPS:NE,iorPS:BE,lightDeclarationPS:UE,lightDiffuseLambertPS:kE,lightDirPointPS:GE,lightEvaluationPS:VE,lightFunctionLightPS:zE,lightFunctionShadowPS:HE,lightingPS:WE,lightmapAddPS:XE,lightmapPS:YE,lightSpecularAnisoGGXPS:jE,lightSpecularGGXPS:qE,lightSpecularBlinnPS:$E,lightSheenPS:KE,linearizeDepthPS:ZE,litForwardBackendPS:QE,litForwardDeclarationPS:JE,litForwardMainPS:ey,litForwardPostCodePS:ty,litForwardPreCodePS:sy,litMainPS:ry,litMainVS:iy,litOtherMainPS:ay,litShaderArgsPS:oy,litShaderCorePS:ny,litShadowMainPS:ly,litUserDeclarationPS:"",litUserDeclarationVS:"",litUserCodePS:"",litUserCodeVS:"",litUserMainStartPS:"",litUserMainStartVS:"",litUserMainEndPS:"",litUserMainEndVS:"",ltcPS:cy,metalnessPS:hy,metalnessModulatePS:fy,morphPS:uy,morphVS:my,msdfPS:dy,msdfVS:py,normalVS:_y,normalCoreVS:gy,normalMapPS:Sy,opacityPS:Ty,opacityDitherPS:Ey,outlineDeclarationPS:yy,outlineOutputPS:Cy,outputPS:vy,outputAlphaPS:xy,outputTex2DPS:Ay,sheenPS:Ry,sheenGlossPS:Py,parallaxPS:Dy,pickPS:Iy,reflDirPS:wy,reflDirAnisoPS:My,reflectionCCPS:Ly,reflectionCubePS:by,reflectionEnvHQPS:Fy,reflectionEnvPS:Oy,reflectionSpherePS:Ny,reflectionSheenPS:By,refractionCubePS:Uy,refractionDynamicPS:ky,reprojectPS:Gy,reprojectVS:Vy,screenDepthPS:zy,shadowCascadesPS:Hy,shadowCasterPS:Wy,shadowEVSMPS:Xy,shadowPCF1PS:Yy,shadowPCF3PS:jy,shadowPCF5PS:qy,shadowPCSSPS:$y,shadowSoftPS:Ky,skinBatchVS:Zy,skinVS:Qy,skyboxPS:Jy,skyboxVS:eC,specularPS:tC,sphericalPS:sC,specularityFactorPS:rC,spotPS:iC,startNineSlicedPS:aC,startNineSlicedTiledPS:oC,stdDeclarationPS:nC,stdFrontEndPS:lC,TBNPS:cC,thicknessPS:hC,tonemappingPS:dC,tonemappingAcesPS:fC,tonemappingAces2PS:uC,tonemappingFilmicPS:mC,tonemappingHejlPS:pC,tonemappingLinearPS:_C,tonemappingNeutralPS:gC,tonemappingNonePS:SC,transformVS:TC,transformCoreVS:EC,transformInstancingVS:yC,transmissionPS:CC,twoSidedLightingPS:vC,uv0VS:xC,uv1VS:AC,uvSetAttributeVS:RC,uvSetVS:PC,uvSetVaryingVS:DC,uvTransformVS:IC,uvTransformUniformsPS:wC,viewDirPS:MC,webgpuPS:gc,webgpuVS:Sc};var bC="";var FC="";var OC="";var NC="";var BC="";var UC="";var kC="";var GC="";var VC="";var zC="";var HC="";var WC="";var XC="";var YC="";var jC="";var qC="";var $C="";var KC="";var ZC="";var QC="";var JC="";var ev="";var tv="";var sv="";var rv="";var iv="";var av="";var ov="";var nv="";var lv="";var cv="";var hv="";var dv="";var fv="";var uv="";var mv="";var pv="";var _v="";var gv="";var Sv="";var Tv="";var Ev="";var yv="";var Cv="";var vv="";var xv="";var Av="";var Rv="";var Pv="";var Dv="";var Iv="";var wv="";var Mv="";var Lv="";var bv="";var Fv="";var Ov="";var Nv="";var Bv="";var Uv="";var kv="";var Gv="";var Vv="";var zv="";var Hv="";var Wv="";var Xv="";var Yv="";var jv="";var qv="";var $v="";var Kv="";var Zv="";var Qv="";var Jv="";var ex="";var tx="";var sx="";var rx={alphaTestPS:"",ambientPS:bC,anisotropyPS:"",aoPS:"",aoDiffuseOccPS:FC,aoSpecOccPS:OC,bakeDirLmEndPS:"",bakeLmEndPS:"",basePS:NC,baseNineSlicedPS:BC,baseNineSlicedTiledPS:UC,bayerPS:"",blurVSMPS:kC,clearCoatPS:"",clearCoatGlossPS:"",clearCoatNormalPS:"",clusteredLightCookiesPS:VC,clusteredLightShadowsPS:zC,clusteredLightUtilsPS:GC,clusteredLightPS:HC,combinePS:WC,cookieBlit2DPS:"",cookieBlitCubePS:"",cookieBlitVS:"",cubeMapProjectPS:XC,cubeMapRotatePS:YC,debugOutputPS:jC,debugProcessFrontendPS:qC,detailModesPS:"",diffusePS:"",decodePS:"",emissivePS:"",encodePS:"",endPS:$C,envAtlasPS:"",envProcPS:"",falloffInvSquaredPS:KC,falloffLinearPS:ZC,flatNormalPS:"",floatAsUintPS:"",sceneTexturesPS:"",fogPS:"",fogMathPS:"",fresnelSchlickPS:QC,frontendCodePS:"",frontendDeclPS:"",fullscreenQuadVS:"",gammaPS:"",glossPS:"",quadVS:"",indirectCoreCS:"",immediateLinePS:"",immediateLineVS:"",iridescenceDiffractionPS:JC,iridescencePS:"",iridescenceThicknessPS:"",iorPS:"",lightDeclarationPS:ev,lightDiffuseLambertPS:tv,lightDirPointPS:sv,lightEvaluationPS:rv,lightFunctionLightPS:iv,lightFunctionShadowPS:av,lightingPS:ov,lightmapAddPS:nv,lightmapPS:"",lightSpecularAnisoGGXPS:lv,lightSpecularGGXPS:cv,lightSpecularBlinnPS:hv,lightSheenPS:dv,linearizeDepthPS:"",litForwardBackendPS:fv,litForwardDeclarationPS:uv,litForwardMainPS:mv,litForwardPostCodePS:pv,litForwardPreCodePS:_v,litMainPS:gv,litMainVS:Sv,litOtherMainPS:Tv,litShaderArgsPS:"",litShaderCorePS:"",litShadowMainPS:Ev,litUserDeclarationPS:"",litUserDeclarationVS:"",litUserCodePS:"",litUserCodeVS:"",litUserMainStartPS:"",litUserMainStartVS:"",litUserMainEndPS:"",litUserMainEndVS:"",ltcPS:yv,meshInstanceStorageVS:"",metalnessPS:"",metalnessModulatePS:Cv,morphPS:"",morphVS:"",msdfPS:"",msdfVS:"",normalVS:vv,normalCoreVS:"",normalMapPS:"",opacityPS:"",opacityDitherPS:"",outlineDeclarationPS:xv,outlineOutputPS:Av,outputPS:Rv,outputAlphaPS:Pv,outputTex2DPS:"",sheenPS:"",sheenGlossPS:"",parallaxPS:"",pickPS:"",reflDirPS:Dv,reflDirAnisoPS:Iv,reflectionCCPS:wv,reflectionCubePS:Mv,reflectionEnvHQPS:Lv,reflectionEnvPS:bv,reflectionSpherePS:Fv,reflectionSheenPS:Ov,refractionCubePS:Nv,refractionDynamicPS:Bv,reprojectPS:"",reprojectVS:"",screenDepthPS:"",shadowCascadesPS:Uv,shadowCasterPS:"",shadowEVSMPS:kv,shadowPCF1PS:Gv,shadowPCF3PS:Vv,shadowPCF5PS:zv,shadowSoftPS:Hv,skinBatchVS:"",skinVS:"",skyboxPS:"",skyboxVS:"",sortIndirectArgsCS:"",specularPS:"",sphericalPS:"",specularityFactorPS:"",spotPS:Wv,startNineSlicedPS:Xv,startNineSlicedTiledPS:Yv,stdDeclarationPS:"",stdFrontEndPS:"",TBNPS:jv,thicknessPS:"",tonemappingPS:"",tonemappingAcesPS:"",tonemappingAces2PS:"",tonemappingFilmicPS:"",tonemappingHejlPS:"",tonemappingLinearPS:"",tonemappingNeutralPS:"",tonemappingNonePS:"",transformVS:"",transformCoreVS:"",transformInstancingVS:"",transmissionPS:"",twoSidedLightingPS:qv,uv0VS:$v,uv1VS:Kv,uvSetAttributeVS:Zv,uvSetVS:Qv,uvSetVaryingVS:Jv,uvTransformVS:ex,uvTransformUniformsPS:tx,viewDirPS:sx,webgpuPS:Tc,webgpuVS:Ec};var Gn=null,BD=1,Vn=class l extends de{_batcher=null;_destroyRequested=!1;_inFrameUpdate=!1;_devtoolsRegistered=!1;_librariesLoaded=!1;_fillMode=_p;_resolutionMode=Fd;_allowResize=!0;_skyboxAsset=null;_soundManager;_visibilityChangeHandler;_entityIndex={};_inTools=!1;_scriptPrefix="";_time=0;enableBundles=typeof TextDecoder<"u";frameRequestId;tick=(e,t)=>{if(!this.graphicsDevice)return;this.frameRequestId&&(this.xr?.session?.cancelAnimationFrame(this.frameRequestId),cancelAnimationFrame(this.frameRequestId),this.frameRequestId=null),this._inFrameUpdate=!0,Od(this),Gn=this;let s=this._processTimestamp(e)||mt(),r=s-(this._time||s),i=r/1e3;if(i=O.clamp(i,0,this.maxDeltaTime),i*=this.timeScale,this._time=s,this.requestAnimationFrame(),this.graphicsDevice.contextLost)return;this.stats.updateBasic(s,i,r,this.renderer,this.graphicsDevice),this.fire("frameupdate",r);let a=!1;t&&(a=!this.xr?.update(t)),a||(this.update(i),this.fire("framerender"),(this.autoRender||this.renderNextFrame)&&(this.render(),this.renderNextFrame=!1),this.fire("frameend"),this.stats.frameEnd()),this._inFrameUpdate=!1,this._destroyRequested&&this.destroy()};timeScale=1;maxDeltaTime=.1;frame=0;frameGraph=new Nd;renderer;scriptsOrder=[];_stats;autoRender=!0;renderNextFrame=!1;graphicsDevice;root;scene;lightmapper=null;loader=new qd(this);assets=new Vd(this.loader);bundles;scenes=new Qd(this);scripts=new Zd(this);systems=new Hd;i18n=new Kd(this);keyboard=null;mouse=null;touch=null;gamepads=null;elementInput=null;xr=null;constructor(e){super(),l._applications[e.id]=this,Od(this),Gn=this,this.root=new as,this.root._enabledInHierarchy=!0}init(e){let{assetPrefix:t,batchManager:s,componentSystems:r,elementInput:i,gamepads:a,graphicsDevice:o,keyboard:n,lightmapper:c,mouse:h,physicsWorld:d,resourceHandlers:f,scriptsOrder:u,scriptPrefix:m,soundManager:_,touch:p,xr:g}=e;this.graphicsDevice=o,Ee.get(o,ce).add(LC),Ee.get(o,q).add(rx),this._initDefaultMaterial(),this._initProgramLibrary(),this._stats=new Jd(this),this._soundManager=_,this.scene=new gd(o),this._registerSceneImmediate(this.scene),t&&(this.assets.prefix=t),this.bundles=new zd(this.assets),this.scriptsOrder=u||[],this.defaultLayerWorld=new gr({name:"World",id:xa}),this.defaultLayerDepth=new gr({name:"Depth",id:it,enabled:!1,opaqueSortMode:Fa}),this.defaultLayerSkybox=new gr({name:"Skybox",id:Aa,opaqueSortMode:Fa}),this.defaultLayerUi=new gr({name:"UI",id:Pa,transparentSortMode:Ig}),this.defaultLayerImmediate=new gr({name:"Immediate",id:Ra,opaqueSortMode:Fa});let T=new Mn("default");T.pushOpaque(this.defaultLayerWorld),T.pushOpaque(this.defaultLayerDepth),T.pushOpaque(this.defaultLayerSkybox),T.pushTransparent(this.defaultLayerWorld),T.pushOpaque(this.defaultLayerImmediate),T.pushTransparent(this.defaultLayerImmediate),T.pushTransparent(this.defaultLayerUi),this.scene.layers=T,Nn.createPlaceholder(o),this.renderer=new Pn(o,this.scene),c&&(this.lightmapper=new c(o,this.root,this.scene,this.renderer,this.assets),this.once("prerender",this._firstBake,this)),s&&(this._batcher=new s(o,this.root,this.scene),this.once("prerender",this._firstBatch,this)),this.keyboard=n||null,this.mouse=h||null,this.touch=p||null,this.gamepads=a||null,i&&(this.elementInput=i,this.elementInput.app=this),this.xr=g?new g(this):null,this.elementInput&&this.elementInput.attachSelectEvents(),this._scriptPrefix=m||"",this.enableBundles&&this.loader.addHandler("bundle",new jd(this)),f.forEach(x=>{let C=new x(this);this.loader.addHandler(C.handlerType,C)}),this.loader.enableRetry(),r.forEach(x=>{this.systems.add(new x(this))}),d&&this.systems.rigidbody?.setPhysicsWorld(d),this._visibilityChangeHandler=this.onVisibilityChange.bind(this),typeof document<"u"&&document.addEventListener("visibilitychange",this._visibilityChangeHandler,!1);let S=e.devtools!==!1?globalThis[Symbol.for("playcanvas.inspector")]:void 0;if(S?.register){this._devtoolsRegistered=!0;try{S.register(this,{version:tl,revision:n_,protocol:BD})}catch{}}}static _applications={};static getApplication(e){return e?l._applications[e]:Vs()}_initDefaultMaterial(){let e=new ur;e.name="Default Material",aS(this.graphicsDevice,e)}_initProgramLibrary(){let e=new Ad(this.graphicsDevice);$g(this.graphicsDevice,e)}get soundManager(){return this._soundManager}get batcher(){return this._batcher}get fillMode(){return this._fillMode}get stats(){return this._stats}get resolutionMode(){return this._resolutionMode}configure(e,t){Zt.get(e,(s,r)=>{if(s){t(s);return}let i=r.application_properties,a=r.scenes,o=r.assets;this._parseApplicationProperties(i,n=>{this._parseScenes(a),this._parseAssets(o),t(n||null)})})}preload(e){this.fire("preload:start");let t=this.assets.list({preload:!0});if(t.length===0){this.fire("preload:end"),e();return}let s=0,r=()=>{s++,this.fire("preload:progress",s/t.length),s===t.length&&(this.fire("preload:end"),e())};t.forEach(i=>{i.loaded?r():(i.once("load",r),i.once("error",r),this.assets.load(i))})}_preloadScripts(e,t){t()}_parseApplicationProperties(e,t){if(typeof e.maxAssetRetries=="number"&&e.maxAssetRetries>0&&this.loader.enableRetry(e.maxAssetRetries),typeof e.maxConcurrentRequests=="number"&&e.maxConcurrentRequests>=0&&(this.loader.maxConcurrentRequests=e.maxConcurrentRequests),typeof e.withCredentials=="boolean"&&(this.loader.withCredentials=e.withCredentials),e.useDevicePixelRatio||(e.useDevicePixelRatio=e.use_device_pixel_ratio),e.resolutionMode||(e.resolutionMode=e.resolution_mode),e.fillMode||(e.fillMode=e.fill_mode),this._width=e.width,this._height=e.height,e.useDevicePixelRatio&&(this.graphicsDevice.maxPixelRatio=window.devicePixelRatio),this.setCanvasResolution(e.resolutionMode,this._width,this._height),this.setCanvasFillMode(e.fillMode,this._width,this._height),e.layers&&e.layerOrder){let s=new Mn("application"),r={};for(let i in e.layers){let a=e.layers[i];a.id=parseInt(i,10),a.enabled=a.id!==it,r[i]=new gr(a)}for(let i=0,a=e.layerOrder.length;i<a;i++){let o=e.layerOrder[i],n=r[o.layer];n&&(o.transparent?s.pushTransparent(n):s.pushOpaque(n),s.subLayerEnabled[i]=o.enabled)}this.scene.layers=s}if(e.batchGroups){let s=this.batcher;if(s)for(let r=0,i=e.batchGroups.length;r<i;r++){let a=e.batchGroups[r];s.addGroup(a.name,a.dynamic,a.maxAabbSize,a.id,a.layers)}}e.i18nAssets&&(this.i18n.assets=e.i18nAssets),this._loadLibraries(e.libraries,t)}_loadLibraries(e,t){let s=e.length,r=s,i=/^https?:\/\//;if(s){let a=(o,n)=>{r--,o?t(o):r===0&&(this.onLibrariesLoaded(),t(null))};for(let o=0;o<s;++o){let n=e[o];!i.test(n.toLowerCase())&&this._scriptPrefix&&(n=oe.join(this._scriptPrefix,n)),this.loader.load(n,"script",a)}}else this.onLibrariesLoaded(),t(null)}_parseScenes(e){if(e)for(let t=0;t<e.length;t++)this.scenes.add(e[t].name,e[t].url)}_parseAssets(e){let t=[],s={},r={};for(let i=0;i<this.scriptsOrder.length;i++){let a=this.scriptsOrder[i];e[a]&&(s[a]=!0,t.push(e[a]))}if(this.enableBundles)for(let i in e)e[i].type==="bundle"&&(r[i]=!0,t.push(e[i]));for(let i in e)s[i]||r[i]||t.push(e[i]);for(let i=0;i<t.length;i++){let a=t[i],o=new is(a.name,a.type,a.file,a.data);if(o.id=parseInt(a.id,10),o.preload=a.preload?a.preload:!1,o.loaded=a.type==="script"&&a.data&&a.data.loadingType>0,o.tags.add(a.tags),a.i18n)for(let n in a.i18n)o.addLocalizedAssetId(n,a.i18n[n]);this.assets.add(o)}}start(){this.frame=0,this.fire("start",{timestamp:mt(),target:this}),this._librariesLoaded||this.onLibrariesLoaded(),this.systems.fire("initialize",this.root),this.fire("initialize"),this.systems.fire("postInitialize",this.root),this.systems.fire("postPostInitialize",this.root),this.fire("postinitialize"),this.requestAnimationFrame()}requestAnimationFrame(){if(this.xr?.session)this.frameRequestId=this.xr.session.requestAnimationFrame(this.tick);else{let e=typeof requestAnimationFrame=="function"&&typeof cancelAnimationFrame=="function";this.frameRequestId=e?requestAnimationFrame(this.tick):null}}inputUpdate(e){this.mouse&&this.mouse.update(),this.keyboard&&this.keyboard.update(),this.gamepads&&this.gamepads.update()}update(e){this.frame++,this.graphicsDevice.update(),this.stats.frame.updateStart=mt(),this.stats.frame.scriptUpdateStart=mt(),this.systems.fire(this._inTools?"toolsUpdate":"update",e),this.stats.frame.scriptUpdate=mt()-this.stats.frame.scriptUpdateStart,this.stats.frame.animUpdateStart=mt(),this.systems.fire("animationUpdate",e),this.stats.frame.animUpdate=mt()-this.stats.frame.animUpdateStart,this.stats.frame.scriptPostUpdateStart=mt(),this.systems.fire("postUpdate",e),this.stats.frame.scriptPostUpdate=mt()-this.stats.frame.scriptPostUpdateStart,this.fire("update",e),this.inputUpdate(e),this.stats.frame.updateTime=mt()-this.stats.frame.updateStart}render(){this.updateCanvasSize(),this.graphicsDevice.frameStart(),this.stats.frame.renderStart=mt(),this.fire("prerender"),this.root.syncHierarchy(),this._batcher&&this._batcher.updateAll(),this.renderComposition(this.scene.layers),this.fire("postrender"),this.stats.frame.renderTime=mt()-this.stats.frame.renderStart,this.graphicsDevice.frameEnd()}renderComposition(e){this.renderer.update(e),this.renderer.buildFrameGraph(this.frameGraph,e),this.renderer.cull(e),this.frameGraph.render(this.graphicsDevice)}setCanvasFillMode(e,t,s){this._fillMode=e,this.resizeCanvas(t,s)}setCanvasResolution(e,t,s){this._resolutionMode=e,e===gp&&t===void 0&&(t=this.graphicsDevice.canvas.clientWidth,s=this.graphicsDevice.canvas.clientHeight),this.graphicsDevice.resizeCanvas(t,s)}isHidden(){return document.hidden}onVisibilityChange(){this.isHidden()?this._soundManager&&this._soundManager.suspend():this._soundManager&&this._soundManager.resume()}resizeCanvas(e,t){if(!this._allowResize||this.xr&&this.xr.session)return;let s=window.innerWidth,r=window.innerHeight;if(this._fillMode===_p){let i=this.graphicsDevice.canvas.width/this.graphicsDevice.canvas.height,a=s/r;i>a?(e=s,t=e/i):(t=r,e=t*i)}else this._fillMode===RT&&(e=s,t=r);return this.graphicsDevice.canvas.style.width=`${e}px`,this.graphicsDevice.canvas.style.height=`${t}px`,this.updateCanvasSize(),{width:e,height:t}}updateCanvasSize(){if(!(!this._allowResize||this.xr?.active)&&this._resolutionMode===gp){let e=this.graphicsDevice.canvas;this.graphicsDevice.resizeCanvas(e.clientWidth,e.clientHeight)}}onLibrariesLoaded(){this._librariesLoaded=!0,this.systems.rigidbody&&this.systems.rigidbody.onLibraryLoaded()}applySceneSettings(e){let t;if(this.systems.rigidbody){let[s,r,i]=e.physics.gravity;this.systems.rigidbody.gravity.set(s,r,i)}this.scene.applySettings(e),e.render.hasOwnProperty("skybox")&&(e.render.skybox?(t=this.assets.get(e.render.skybox),t?this.setSkybox(t):this.assets.once(`add:${e.render.skybox}`,this.setSkybox,this)):this.setSkybox(null))}setAreaLightLuts(e,t){e&&t&&Nn.set(this.graphicsDevice,e,t)}setSkybox(e){e!==this._skyboxAsset&&(this._skyboxAsset&&(this.assets.off(`load:${this._skyboxAsset.id}`,this._onSkyboxChanged,this),this.assets.off(`remove:${this._skyboxAsset.id}`,this._onSkyboxRemoved,this),this._skyboxAsset.off("change",this._onSkyboxChanged,this)),this._skyboxAsset=e,this._skyboxAsset&&(this.assets.on(`load:${this._skyboxAsset.id}`,this._onSkyboxChanged,this),this.assets.once(`remove:${this._skyboxAsset.id}`,this._onSkyboxRemoved,this),this._skyboxAsset.on("change",this._onSkyboxChanged,this),this.scene.skyboxMip===0&&!this._skyboxAsset.loadFaces&&(this._skyboxAsset.loadFaces=!0),this.assets.load(this._skyboxAsset)),this._onSkyboxChanged())}_onSkyboxRemoved(){this.setSkybox(null)}_onSkyboxChanged(){this.scene.setSkybox(this._skyboxAsset?this._skyboxAsset.resources:null)}_firstBake(){this.lightmapper?.bake(null,this.scene.lightmapMode)}_firstBatch(){this.batcher?.generate()}_processTimestamp(e){return e}drawLine(e,t,s,r,i){this.scene.drawLine(e,t,s,r,i)}drawLines(e,t,s=!0,r=this.scene.defaultDrawLayer){this.scene.drawLines(e,t,s,r)}drawLineArrays(e,t,s=!0,r=this.scene.defaultDrawLayer){this.scene.drawLineArrays(e,t,s,r)}drawWireSphere(){}drawWireAlignedBox(){}drawMeshInstance(){}drawMesh(){}drawQuad(){}drawTexture(){}drawDepthTexture(){}destroy(){if(this._inFrameUpdate){this._destroyRequested=!0;return}if(this._devtoolsRegistered){this._devtoolsRegistered=!1;try{globalThis[Symbol.for("playcanvas.inspector")]?.unregister?.(this)}catch{}}let e=this.graphicsDevice.canvas.id;this.fire("destroy",this),this.off("librariesloaded"),this._gsplatSortedEvt?.off(),this._gsplatSortedEvt=null,typeof document<"u"&&document.removeEventListener("visibilitychange",this._visibilityChangeHandler,!1),this._visibilityChangeHandler=null,this.root.destroy(),this.root=null,this.mouse&&(this.mouse.off(),this.mouse.detach(),this.mouse=null),this.keyboard&&(this.keyboard.off(),this.keyboard.detach(),this.keyboard=null),this.touch&&(this.touch.off(),this.touch.detach(),this.touch=null),this.elementInput&&(this.elementInput.detach(),this.elementInput=null),this.gamepads&&(this.gamepads.destroy(),this.gamepads=null),this.systems.destroy(),this.bundles.destroy(),this.bundles=null,this.i18n.destroy(),this.i18n=null,this.loader.getHandler("script")?.clearCache(),this.loader.destroy(),this.loader=null,this.systems=null,this.context=null,this.scripts.destroy(),this.scripts=null,this.scenes.destroy(),this.scenes=null,this.lightmapper?.destroy(),this.lightmapper=null,this._batcher&&(this._batcher.destroy(),this._batcher=null),this._entityIndex={},this.defaultLayerDepth.onDisable=null,this.defaultLayerDepth.onEnable=null,this.defaultLayerDepth=null,this.defaultLayerWorld=null,this.xr?.end(),this.xr?.destroy(),this.renderer.destroy(),this.renderer=null;let s=this.assets.list();for(let r=0;r<s.length;r++)s[r].unload(),s[r].off();this.assets.destroy(),this.assets=null,this.scene.destroy(),this.scene=null,this.graphicsDevice.destroy(),this.graphicsDevice=null,this.off(),this._soundManager?.destroy(),this._soundManager=null,IT.app=null,l._applications[e]=null,Vs()===this&&Od(null),Gn===this&&(Gn=null),l.cancelTick(this)}static cancelTick(e){e.frameRequestId&&(cancelAnimationFrame(e.frameRequestId),e.frameRequestId=void 0)}getEntityFromIndex(e){return this._entityIndex[e]}_registerSceneImmediate(e){this.on("postrender",e.immediate.onPostRender,e.immediate),this._gsplatSortedEvt=e.on("gsplat:sorted",t=>{this.stats.frame.gsplatSort+=t})}isFullscreen(){return!!document.fullscreenElement}enableFullscreen(e,t,s){e=e||this.graphicsDevice.canvas;let r=function(){t(),document.removeEventListener("fullscreenchange",r)},i=function(){s(),document.removeEventListener("fullscreenerror",i)};t&&document.addEventListener("fullscreenchange",r,!1),s&&document.addEventListener("fullscreenerror",i,!1),e.requestFullscreen?e.requestFullscreen(Element.ALLOW_KEYBOARD_INPUT):s()}disableFullscreen(e){let t=function(){e(),document.removeEventListener("fullscreenchange",t)};e&&document.addEventListener("fullscreenchange",t,!1),document.exitFullscreen()}getSceneUrl(e){let t=this.scenes.find(e);return t?t.url:null}loadScene(e,t){this.scenes.loadScene(e,t)}loadSceneHierarchy(e,t){this.scenes.loadSceneHierarchy(e,t)}loadSceneSettings(e,t){this.scenes.loadSceneSettings(e,t)}};Pn.prototype.renderComposition=function(l){Vs().renderComposition(l)};var zn=class{elementInput;keyboard;mouse;touch;gamepads;scriptPrefix;assetPrefix;scriptsOrder;soundManager;physicsWorld;graphicsDevice;lightmapper;batchManager;xr;componentSystems=[];resourceHandlers=[];devtools=!0};var no=class extends de{id;extraDataProperties=[];_validProps=null;constructor(e){super(),this.app=e,this.store={},this.schema=[]}addComponent(e,t={}){let s=new this.ComponentType(this,e),r=this.DataType?new this.DataType:{};return this.store[e.guid]={entity:e,data:r},e[this.id]=s,e.c[this.id]=s,this.initializeComponentData(s,t),this.fire("add",e,s),s}removeComponent(e){let t=this.id,s=this.store[e.guid],r=e.c[t];r.fire("beforeremove"),this.fire("beforeremove",e,r),delete this.store[e.guid],e[t]=void 0,delete e.c[t],this.fire("remove",e,s.data)}cloneComponent(e,t){let s=this.store[e.guid];return this.addComponent(t,s.data)}initializeComponentData(e,t={},s){if(s)for(let r=0,i=s.length;r<i;r++){let a=s[r],o,n;typeof a=="object"?(o=a.name,n=a.type):(o=a,n=void 0);let c=t[o];c!==void 0?(n!==void 0&&(c=UD(c,n)),e[o]=c):e.data&&o in e.data&&(e[o]=e.data[o])}else t.enabled!==void 0&&(e.enabled=t.enabled);e.enabled&&e.entity.enabled&&e.onEnable()}getPropertiesOfType(e){let t=[];return(this.schema||[]).forEach(r=>{r&&typeof r=="object"&&r.type===e&&t.push(r)}),t}destroy(){this.off()}};function UD(l,e){if(!l)return l;switch(e){case"rgb":return l instanceof z?l.clone():new z(l[0],l[1],l[2]);case"rgba":return l instanceof z?l.clone():new z(l[0],l[1],l[2],l[3]);case"vec2":return l instanceof k?l.clone():new k(l[0],l[1]);case"vec3":return l instanceof y?l.clone():new y(l[0],l[1],l[2]);case"vec4":return l instanceof ne?l.clone():new ne(l[0],l[1],l[2],l[3]);case"boolean":case"number":case"string":return l;case"entity":return l;default:throw new Error(`Could not convert unhandled type: ${e}`)}}var lo=class l extends de{static order=0;system;entity;_enabled=!0;constructor(e,t){super(),this.system=e,this.entity=t,this.system.schema?.length&&!this._accessorsBuilt&&this.buildAccessors(this.system.schema),this.on("set",function(s,r,i){this.fire(`set_${s}`,s,r,i)}),this.on("set_enabled",this.onSetEnabled,this)}static _buildAccessors(e,t){t.forEach(s=>{let r=typeof s=="object"?s.name:s;Object.defineProperty(e,r,{get:function(){return this.data[r]},set:function(i){let a=this.data,o=a[r];a[r]=i,this.fire("set",r,o,i)},configurable:!0})}),e._accessorsBuilt=!0}buildAccessors(e){l._buildAccessors(this,e)}onSetEnabled(e,t,s){t!==s&&this.entity.enabled&&(s?this.onEnable():this.onDisable())}onEnable(){}onDisable(){}onPostStateChange(){}get data(){let e=this.system.store[this.entity.guid];return e?e.data:null}set enabled(e){let t=this._enabled;this._enabled=e,this.fire("set","enabled",t,e)}get enabled(){return this._enabled}};var ef=class{_evtLoadById=null;_evtUnloadById=null;_evtAddById=null;_evtRemoveById=null;_evtLoadByUrl=null;_evtAddByUrl=null;_evtRemoveByUrl=null;constructor(e,t,s,r,i){this.propertyName=e,this.parent=t,this._scope=i,this._registry=s,this.id=null,this.url=null,this.asset=null,this._onAssetLoad=r.load,this._onAssetAdd=r.add,this._onAssetRemove=r.remove,this._onAssetUnload=r.unload}set id(e){if(this.url)throw Error("Can't set id and url");this._unbind(),this._id=e,this.asset=this._id===null?null:this._registry.get(this._id),this._bind()}get id(){return this._id}set url(e){if(this.id)throw Error("Can't set id and url");this._unbind(),this._url=e,this.asset=this._url===null?null:this._registry.getByUrl(this._url),this._bind()}get url(){return this._url}_bind(){this.id&&(this._onAssetLoad&&(this._evtLoadById=this._registry.on(`load:${this.id}`,this._onLoad,this)),this._onAssetAdd&&(this._evtAddById=this._registry.once(`add:${this.id}`,this._onAdd,this)),this._onAssetRemove&&(this._evtRemoveById=this._registry.on(`remove:${this.id}`,this._onRemove,this)),this._onAssetUnload&&(this._evtUnloadById=this._registry.on(`unload:${this.id}`,this._onUnload,this))),this.url&&(this._onAssetLoad&&(this._evtLoadByUrl=this._registry.on(`load:url:${this.url}`,this._onLoad,this)),this._onAssetAdd&&(this._evtAddByUrl=this._registry.once(`add:url:${this.url}`,this._onAdd,this)),this._onAssetRemove&&(this._evtRemoveByUrl=this._registry.on(`remove:url:${this.url}`,this._onRemove,this)))}_unbind(){this.id&&(this._evtLoadById?.off(),this._evtLoadById=null,this._evtAddById?.off(),this._evtAddById=null,this._evtRemoveById?.off(),this._evtRemoveById=null,this._evtUnloadById?.off(),this._evtUnloadById=null),this.url&&(this._evtLoadByUrl?.off(),this._evtLoadByUrl=null,this._evtAddByUrl?.off(),this._evtAddByUrl=null,this._evtRemoveByUrl?.off(),this._evtRemoveByUrl=null)}_onLoad(e){this._onAssetLoad.call(this._scope,this.propertyName,this.parent,e)}_onAdd(e){this.asset=e,this._onAssetAdd.call(this._scope,this.propertyName,this.parent,e)}_onRemove(e){this._onAssetRemove.call(this._scope,this.propertyName,this.parent,e),this.asset=null}_onUnload(e){this._onAssetUnload.call(this._scope,this.propertyName,this.parent,e)}};var Ep=class{constructor(e,t){this.effect=e,this.inputTarget=t,this.outputTarget=null,this.name=e.constructor.name}},tf=class{constructor(e,t){this.app=e,this.camera=t,this.destinationRenderTarget=null,this.effects=[],this.enabled=!1,this.depthTarget=null,t.on("set:rect",this.onCameraRectChanged,this)}_allocateColorBuffer(e,t){let s=this.camera.rect,r=this.destinationRenderTarget,i=this.app.graphicsDevice,a=Math.floor(s.z*(r?.width??i.width)),o=Math.floor(s.w*(r?.height??i.height));return se.createDataTexture2D(i,t,a,o,e)}_createOffscreenTarget(e,t){let s=this.app.graphicsDevice,i=(this.destinationRenderTarget??s.backBuffer).isColorBufferSrgb(0),a=(t&&s.getRenderableHdrFormat([ge,We],!0))??(i?vr:Re),o=`${this.camera.entity.name}-posteffect-${this.effects.length}`,n=this._allocateColorBuffer(a,o);return new Le({colorBuffer:n,depth:e,stencil:e&&this.app.graphicsDevice.supportsStencil,samples:e?s.samples:1})}_resizeOffscreenTarget(e){let t=e.colorBuffer.format,s=e.colorBuffer.name;e.destroyFrameBuffers(),e.destroyTextureBuffers(),e._colorBuffer=this._allocateColorBuffer(t,s),e._colorBuffers=[e._colorBuffer],e.evaluateDimensions()}_destroyOffscreenTarget(e){e.destroyTextureBuffers(),e.destroy()}addEffect(e){let t=this.effects,s=t.length===0,r=this._createOffscreenTarget(s,e.hdr),i=new Ep(e,r);t.push(i),this._sourceTarget=i.inputTarget,t.length>1&&(t[t.length-2].outputTarget=i.inputTarget),this._newPostEffect=e,e.needsDepthBuffer&&this._requestDepthMap(),this.enable(),this._newPostEffect=void 0}removeEffect(e){let t=-1;for(let s=0,r=this.effects.length;s<r;s++)if(this.effects[s].effect===e){t=s;break}t>=0&&(t>0?this.effects[t-1].outputTarget=t+1<this.effects.length?this.effects[t+1].inputTarget:null:this.effects.length>1&&(this.effects[1].inputTarget._depth||(this._destroyOffscreenTarget(this.effects[1].inputTarget),this.effects[1].inputTarget=this._createOffscreenTarget(!0,this.effects[1].hdr),this._sourceTarget=this.effects[1].inputTarget),this.camera.renderTarget=this.effects[1].inputTarget),this._destroyOffscreenTarget(this.effects[t].inputTarget),this.effects.splice(t,1)),this.enabled&&e.needsDepthBuffer&&this._releaseDepthMap(),this.effects.length===0&&this.disable()}_requestDepthMaps(){for(let e=0,t=this.effects.length;e<t;e++){let s=this.effects[e].effect;this._newPostEffect!==s&&s.needsDepthBuffer&&this._requestDepthMap()}}_releaseDepthMaps(){for(let e=0,t=this.effects.length;e<t;e++)this.effects[e].effect.needsDepthBuffer&&this._releaseDepthMap()}_requestDepthMap(){let e=this.app.scene.layers.getLayerById(it);e&&(e.incrementCounter(),this.camera.requestSceneDepthMap(!0))}_releaseDepthMap(){let e=this.app.scene.layers.getLayerById(it);e&&(e.decrementCounter(),this.camera.requestSceneDepthMap(!1))}destroy(){for(let e=0,t=this.effects.length;e<t;e++)this.effects[e].inputTarget.destroy();this.effects.length=0,this.disable()}enable(){!this.enabled&&this.effects.length&&(this.enabled=!0,this._requestDepthMaps(),this.app.graphicsDevice.on("resizecanvas",this._onCanvasResized,this),this.destinationRenderTarget=this.camera.renderTarget,this.camera.renderTarget=this.effects[0].inputTarget,this.camera.onPostprocessing=()=>{if(this.enabled){let e=null,t=this.effects.length;if(t)for(let s=0;s<t;s++){let r=this.effects[s],i=r.outputTarget;s===t-1&&(e=this.camera.rect,this.destinationRenderTarget&&(i=this.destinationRenderTarget)),r.effect.render(r.inputTarget,i,e)}}})}disable(){this.enabled&&(this.enabled=!1,this.app.graphicsDevice.off("resizecanvas",this._onCanvasResized,this),this._releaseDepthMaps(),this._destroyOffscreenTarget(this._sourceTarget),this.camera.renderTarget=this.destinationRenderTarget,this.camera.onPostprocessing=null)}_onCanvasResized(e,t){let s=this.camera.rect,r=this.destinationRenderTarget;e=r?.width??e,t=r?.height??t,this.camera.camera.aspectRatio=e*s.z/(t*s.w),this.resizeRenderTargets()}resizeRenderTargets(){let e=this.app.graphicsDevice,t=this.destinationRenderTarget,s=t?.width??e.width,r=t?.height??e.height,i=this.camera.rect,a=Math.floor(i.z*s),o=Math.floor(i.w*r),n=this.effects;for(let c=0,h=n.length;c<h;c++){let d=n[c];(d.inputTarget.width!==a||d.inputTarget.height!==o)&&this._resizeOffscreenTarget(d.inputTarget)}}onCameraRectChanged(e,t,s){this.enabled&&this.resizeRenderTargets()}};var sf=class extends lo{onPostprocessing=null;_renderSceneDepthMap=0;_renderSceneColorMap=0;_sceneDepthMapRequested=!1;_sceneColorMapRequested=!1;_priority=0;_disablePostEffectsLayer=Pa;_camera;_evtLayersChanged=null;_evtLayerAdded=null;_evtLayerRemoved=null;constructor(e,t){super(e,t),this._camera=new Vt(e.app.graphicsDevice),this._camera.node=t,this._postEffects=new tf(e.app,this)}setShaderPass(e){let t=at.get(this.system.app.graphicsDevice),s=e?t.allocate(e,{isForward:!0}):null;return this._camera.shaderPassInfo=s,s?.index??jr}getShaderPass(){return this._camera.shaderPassInfo?.name}set framePasses(e){this._camera.framePasses=e||[],this.dirtyLayerCompositionCameras(),this.system.app.scene.updateShaders=!0}get framePasses(){return this._camera.framePasses}set renderPasses(e){this.framePasses=e}get renderPasses(){return this.framePasses}get shaderParams(){return this._camera.shaderParams}set gammaCorrection(e){this.camera.shaderParams.gammaCorrection=e}get gammaCorrection(){return this.camera.shaderParams.gammaCorrection}set toneMapping(e){this.camera.shaderParams.toneMapping=e}get toneMapping(){return this.camera.shaderParams.toneMapping}set fog(e){this._camera.fogParams=e}get fog(){return this._camera.fogParams}set aperture(e){this._camera.aperture=e}get aperture(){return this._camera.aperture}set aspectRatio(e){this._camera.aspectRatio=e}get aspectRatio(){return this._camera.aspectRatio}set aspectRatioMode(e){this._camera.aspectRatioMode=e}get aspectRatioMode(){return this._camera.aspectRatioMode}set calculateProjection(e){this._camera.calculateProjection=e}get calculateProjection(){return this._camera.calculateProjection}set calculateTransform(e){this._camera.calculateTransform=e}get calculateTransform(){return this._camera.calculateTransform}get camera(){return this._camera}set clearColor(e){this._camera.clearColor=e}get clearColor(){return this._camera.clearColor}setClearColor(e,t){this._camera.setClearColor(e,t)}getClearColor(e){return this._camera.getClearColor(e)}set clearColorBuffer(e){this._camera.clearColorBuffer=e,this.dirtyLayerCompositionCameras()}get clearColorBuffer(){return this._camera.clearColorBuffer}set clearDepth(e){this._camera.clearDepth=e}get clearDepth(){return this._camera.clearDepth}set clearDepthBuffer(e){this._camera.clearDepthBuffer=e,this.dirtyLayerCompositionCameras()}get clearDepthBuffer(){return this._camera.clearDepthBuffer}set clearStencilBuffer(e){this._camera.clearStencilBuffer=e,this.dirtyLayerCompositionCameras()}get clearStencilBuffer(){return this._camera.clearStencilBuffer}set cullFaces(e){this._camera.cullFaces=e}get cullFaces(){return this._camera.cullFaces}set disablePostEffectsLayer(e){this._disablePostEffectsLayer=e,this.dirtyLayerCompositionCameras()}get disablePostEffectsLayer(){return this._disablePostEffectsLayer}set farClip(e){this._camera.farClip=e,this.fire("set:farClip",e)}get farClip(){return this._camera.farClip}set flipFaces(e){this._camera.flipFaces=e}get flipFaces(){return this._camera.flipFaces}set fov(e){this._camera.fov=e}get fov(){return this._camera.fov}get frustum(){return this._camera.frustum}set frustumCulling(e){this._camera.frustumCulling=e}get frustumCulling(){return this._camera.frustumCulling}set horizontalFov(e){this._camera.horizontalFov=e}get horizontalFov(){return this._camera.horizontalFov}set layers(e){let t=this._camera.layers,s=this.system.app.scene;t.forEach(r=>{s.layers.getLayerById(r)?.removeCamera(this)}),this._camera.layers=e,this.enabled&&this.entity.enabled&&e.forEach(r=>{s.layers.getLayerById(r)?.addCamera(this)}),this.fire("set:layers")}get layers(){return this._camera.layers}get layersSet(){return this._camera.layersSet}set jitter(e){this._camera.jitter=e}get jitter(){return this._camera.jitter}set nearClip(e){this._camera.nearClip=e,this.fire("set:nearClip",e)}get nearClip(){return this._camera.nearClip}set orthoHeight(e){this._camera.orthoHeight=e}get orthoHeight(){return this._camera.orthoHeight}get postEffects(){return this._postEffects}get postEffectsEnabled(){return this._postEffects.enabled}set priority(e){this._priority=e,this.dirtyLayerCompositionCameras()}get priority(){return this._priority}set projection(e){this._camera.projection=e}get projection(){return this._camera.projection}get projectionMatrix(){return this._camera.projectionMatrix}set projectionOffset(e){this._camera.projectionOffset=e}get projectionOffset(){return this._camera.projectionOffset}set rect(e){this._camera.rect=e,this.fire("set:rect",this._camera.rect)}get rect(){return this._camera.rect}set renderSceneColorMap(e){e&&!this._sceneColorMapRequested?(this.requestSceneColorMap(!0),this._sceneColorMapRequested=!0):!e&&this._sceneColorMapRequested&&(this.requestSceneColorMap(!1),this._sceneColorMapRequested=!1)}get renderSceneColorMap(){return this._renderSceneColorMap>0}set renderSceneDepthMap(e){e&&!this._sceneDepthMapRequested?(this.requestSceneDepthMap(!0),this._sceneDepthMapRequested=!0):!e&&this._sceneDepthMapRequested&&(this.requestSceneDepthMap(!1),this._sceneDepthMapRequested=!1)}get renderSceneDepthMap(){return this._renderSceneDepthMap>0}set renderTarget(e){this._camera.renderTarget=e,this.dirtyLayerCompositionCameras()}get renderTarget(){return this._camera.renderTarget}set scissorRect(e){this._camera.scissorRect=e}get scissorRect(){return this._camera.scissorRect}set sensitivity(e){this._camera.sensitivity=e}get sensitivity(){return this._camera.sensitivity}set shutter(e){this._camera.shutter=e}get shutter(){return this._camera.shutter}get viewMatrix(){return this._camera.viewMatrix}_enableDepthLayer(e){if(this.layers.find(s=>s===it)){let s=this.system.app.scene.layers.getLayerById(it);e?s?.incrementCounter():s?.decrementCounter()}else if(e)return!1;return!0}requestSceneColorMap(e){this._renderSceneColorMap+=e?1:-1;let t=this._enableDepthLayer(e);this.camera._enableRenderPassColorGrab(this.system.app.graphicsDevice,this.renderSceneColorMap),this.system.app.scene.layers.markDirty()}requestSceneDepthMap(e){this._renderSceneDepthMap+=e?1:-1;let t=this._enableDepthLayer(e);this.camera._enableRenderPassDepthGrab(this.system.app.graphicsDevice,this.system.app.renderer,this.renderSceneDepthMap),this.system.app.scene.layers.markDirty()}dirtyLayerCompositionCameras(){let e=this.system.app.scene.layers;e._dirty=!0}screenToWorld(e,t,s,r){let i=this.system.app.graphicsDevice,{width:a,height:o}=i.clientRect;return this._camera.screenToWorld(e,t,s,a,o,r)}worldToScreen(e,t){let s=this.system.app.graphicsDevice,{width:r,height:i}=s.clientRect;return this._camera.worldToScreen(e,r,i,t)}onAppPrerender(){this._camera._viewMatDirty=!0,this._camera._viewProjMatDirty=!0}addCameraToLayers(){let e=this.layers;for(let t=0;t<e.length;t++){let s=this.system.app.scene.layers.getLayerById(e[t]);s&&s.addCamera(this)}}removeCameraFromLayers(){let e=this.layers;for(let t=0;t<e.length;t++){let s=this.system.app.scene.layers.getLayerById(e[t]);s&&s.removeCamera(this)}}onLayersChanged(e,t){this.addCameraToLayers(),this._evtLayerAdded?.off(),this._evtLayerAdded=t.on("add",this.onLayerAdded,this),this._evtLayerRemoved?.off(),this._evtLayerRemoved=t.on("remove",this.onLayerRemoved,this)}onLayerAdded(e){this.layers.indexOf(e.id)<0||e.addCamera(this)}onLayerRemoved(e){this.layers.indexOf(e.id)<0||e.removeCamera(this)}onEnable(){let e=this.system.app.scene,t=e.layers;this.system.addCamera(this),this._evtLayersChanged?.off(),this._evtLayersChanged=e.on("set:layers",this.onLayersChanged,this),t&&(this._evtLayerAdded?.off(),this._evtLayerAdded=t.on("add",this.onLayerAdded,this),this._evtLayerRemoved?.off(),this._evtLayerRemoved=t.on("remove",this.onLayerRemoved,this)),this.enabled&&this.entity.enabled&&this.addCameraToLayers(),this.postEffects.enable()}onDisable(){let t=this.system.app.scene.layers;this.postEffects.disable(),this.removeCameraFromLayers(),this._evtLayersChanged?.off(),this._evtLayersChanged=null,t&&(this._evtLayerAdded?.off(),this._evtLayerAdded=null,this._evtLayerRemoved?.off(),this._evtLayerRemoved=null),this.system.removeCamera(this)}onBeforeRemove(){this.onDisable(),this.off(),this.camera.destroy()}calculateAspectRatio(e){return this._camera.calculateAspectRatio(e)}startXr(e,t,s){this.system.app.xr.start(this,e,t,s)}endXr(e){let t=this.system.app.xr;if(t?.camera!==this.entity){e&&e(new Error("Camera is not in XR"));return}t.end(e)}copy(e){this.aperture=e.aperture,this.aspectRatio=e.aspectRatio,this.aspectRatioMode=e.aspectRatioMode,this.calculateProjection=e.calculateProjection,this.calculateTransform=e.calculateTransform,this.clearColor=e.clearColor,this._camera._clearColors=null,e._camera._clearColors?.forEach((t,s)=>this.setClearColor(s,t)),this.clearColorBuffer=e.clearColorBuffer,this.clearDepthBuffer=e.clearDepthBuffer,this.clearStencilBuffer=e.clearStencilBuffer,this.cullFaces=e.cullFaces,this.disablePostEffectsLayer=e.disablePostEffectsLayer,this.farClip=e.farClip,this.flipFaces=e.flipFaces,this.fov=e.fov,this.frustumCulling=e.frustumCulling,this.horizontalFov=e.horizontalFov,this.layers=e.layers,this.nearClip=e.nearClip,this.orthoHeight=e.orthoHeight,this.priority=e.priority,this.projection=e.projection,this.projectionOffset=e.projectionOffset,this.rect=e.rect,this.renderTarget=e.renderTarget,this.scissorRect=e.scissorRect,this.sensitivity=e.sensitivity,this.shutter=e.shutter}};var rf=["aspectRatio","aspectRatioMode","calculateProjection","calculateTransform","clearColor","clearColorBuffer","clearDepth","clearDepthBuffer","clearStencilBuffer","renderSceneColorMap","renderSceneDepthMap","cullFaces","farClip","flipFaces","fog","fov","frustumCulling","horizontalFov","layers","renderTarget","nearClip","orthoHeight","projection","projectionOffset","priority","rect","scissorRect","aperture","shutter","sensitivity","gammaCorrection","toneMapping"],Hn=class extends no{cameras=[];constructor(e){super(e),this.id="camera",this.ComponentType=sf,this.on("beforeremove",this.onBeforeRemove,this),this.app.on("prerender",this.onAppPrerender,this)}initializeComponentData(e,t){for(let s=0;s<rf.length;s++){let r=rf[s];if(t.hasOwnProperty(r)){let i=t[r];switch(r){case"rect":case"scissorRect":Array.isArray(i)?e[r]=new ne(i[0],i[1],i[2],i[3]):e[r]=i;break;case"clearColor":Array.isArray(i)?e[r]=new z(i[0],i[1],i[2],i[3]):e[r]=i;break;case"projectionOffset":Array.isArray(i)?e[r]=new k(i[0],i[1]):e[r]=i;break;default:e[r]=i;break}}}super.initializeComponentData(e,t)}cloneComponent(e,t){let s=e.camera,r={enabled:s.enabled};for(let a=0;a<rf.length;a++){let o=rf[a];r[o]=s[o]}let i=this.addComponent(t,r);return s._camera._clearColors?.forEach((a,o)=>i.setClearColor(o,a)),i}onBeforeRemove(e,t){this.removeCamera(t),t.onBeforeRemove()}onAppPrerender(){for(let e=0,t=this.cameras.length;e<t;e++)this.cameras[e].onAppPrerender()}addCamera(e){this.cameras.push(e),wn(this.cameras)}removeCamera(e){let t=this.cameras.indexOf(e);t>=0&&(this.cameras.splice(t,1),wn(this.cameras))}destroy(){this.app.off("prerender",this.onAppPrerender,this),super.destroy()}};function ix(l){let e=new Map,t,s,r,i,a=!1,o=!1,n=32,c=new Float32Array(n+1),h=new Float32Array(n+1),d=new GSplatSortBinWeights,f=C=>{for(let E=0;E<n;E++)c[E]=C[E*2],h[E]=C[E*2+1];c[n]=c[n-1]+h[n-1],h[n]=0},u=(C,E,v,A,D,R,w)=>{let{ids:M,intervals:P}=R,L=n/v,G=0;for(let U=0;U<C.length;U++){let F=C[U],Y=M[U],K=e.get(Y);K||console.error("UnifiedSortWorker: No centers found for id",Y);let W=P[U].length>0?P[U]:[0,K.length/3];for(let ae=0;ae<W.length;ae+=2){let H=W[ae]*3,ee=W[ae+1]*3;G=w(K,F,H,ee,G,L,E,v,A,D)}}},m=(C,E,v,A,D,R)=>{u(C,E,v,A,D,R,(w,M,P,L,G,U,F,Y,K,W)=>{let{transformedDirection:ae,offset:H,scale:ee}=M,Ze=ae.x,he=ae.y,j=ae.z,He=Ze*ee,ut=he*ee,Ct=j*ee,Ht=H-F;for(let vt=P;vt<L;vt+=3){let ii=w[vt],Ni=w[vt+1],Ws=w[vt+2],i_=(ii*He+Ni*ut+Ws*Ct+Ht)*U,Uf=i_>>>0,a_=c[Uf]+h[Uf]*(i_-Uf)>>>0;K[G++]=a_,W[a_]++}return G})},_=(C,E,v,A,D,R)=>{u(C,E,v,A,D,R,(w,M,P,L,G,U,F,Y,K,W)=>{let{transformedPosition:ae,scale:H}=M,ee=ae.x,Ze=ae.y,he=ae.z;for(let j=P;j<L;j+=3){let He=w[j]-ee,ut=w[j+1]-Ze,Ct=w[j+2]-he,Ht=He*He+ut*ut+Ct*Ct,vt=Math.sqrt(Ht)*H,Ni=(Y-vt)*U,Ws=Ni>>>0,Bf=c[Ws]+h[Ws]*(Ni-Ws)>>>0;K[G++]=Bf,W[Bf]++}return G})},p=(C,E,v,A,D)=>{for(let w=1;w<C;w++)E[w]+=E[w-1];let R=E[C-1];R!==v&&!o&&(o=!0,console.warn(`[SortWorker] ${v-R} splats lost due to sortKey overflow. Check resource AABB bounds contain all the splats.`));for(let w=0;w<v;w++){let M=A[w],P=--E[M];D[P]=i[w]}},g=C=>{let E=1/0,v=-1/0;for(let A=0;A<C.length;A++){let D=C[A],{transformedDirection:R,offset:w,scale:M,aabbMin:P,aabbMax:L}=D,G=R.x,U=R.y,F=R.z,Y=G>=0?P[0]:L[0],K=U>=0?P[1]:L[1],W=F>=0?P[2]:L[2],ae=G>=0?L[0]:P[0],H=U>=0?L[1]:P[1],ee=F>=0?L[2]:P[2],Ze=Y*G+K*U+W*F,he=ae*G+H*U+ee*F,j=Ze*M+w,He=he*M+w,ut=Math.min(j,He),Ct=Math.max(j,He);ut<E&&(E=ut),Ct>v&&(v=Ct)}return E===1/0&&(E=0,v=0),{minDist:E,maxDist:v}},T=C=>{let E=-1/0;for(let A=0;A<C.length;A++){let D=C[A],{transformedPosition:R,scale:w,aabbMin:M,aabbMax:P}=D,L=R.x,G=R.y,U=R.z;for(let F=0;F<8;F++){let Y=F&1?P[0]:M[0],K=F&2?P[1]:M[1],W=F&4?P[2]:M[2],ae=Y-L,H=K-G,ee=W-U,Ze=ae*ae+H*H+ee*ee,he=Math.sqrt(Ze)*w;he>E&&(E=he)}}let v=0;return E<0&&(E=0),{minDist:v,maxDist:E}},S=(C,E,v)=>{let A=performance.now(),{minDist:D,maxDist:R}=a?T(C):g(C),w=v.totalActiveSplats,P=2**Math.max(10,Math.min(20,Math.round(Math.log2(w/4))))+1;s?.length!==w&&(s=new Uint32Array(w)),!r||r.length!==P?r=new Uint32Array(P):r.fill(0);let L=R-D,G=GSplatSortBinWeights.computeCameraBin(a,D,L),U=d.compute(G,P);f(U),a?_(C,D,L,s,r,v):m(C,D,L,s,r,v),p(P,r,w,s,E);let F=w,Y=performance.now()-A,K=[E.buffer],W={order:E.buffer,count:F,version:v.version,sortTime:Y};l.postMessage(W,K)},x=C=>{let{ids:E,pixelOffsets:v,intervals:A,totalActiveSplats:D}=C;(!i||i.length<D)&&(i=new Uint32Array(D));let R=0;for(let w=0;w<E.length;w++){let M=e.get(E[w]),P=v[w],L=A[w].length>0?A[w]:[0,M.length/3];for(let G=0;G<L.length;G+=2){let U=P[G/2],F=L[G+1]-L[G];for(let Y=0;Y<F;Y++)i[R++]=U++}}};l.addEventListener("message",C=>{let E=C.data??C;switch(E.command){case"addCenters":{e.set(E.id,new Float32Array(E.centers));break}case"removeCenters":{e.delete(E.id);break}case"sort":{a=E.radialSorting||!1;let v=new Uint32Array(E.order);S(E.sortParams,v,t);break}case"intervals":{t=E,x(t);break}}})}var Tr=class l{static get NUM_BINS(){return 32}static get WEIGHT_TIERS(){return[{maxDistance:0,weight:40},{maxDistance:2,weight:20},{maxDistance:5,weight:8},{maxDistance:10,weight:3},{maxDistance:1/0,weight:1}]}constructor(){let e=l.NUM_BINS,t=l.WEIGHT_TIERS;this.binWeights=new Float32Array(e*2),this.bitsPerBin=new Float32Array(e),this.weightByDistance=new Float32Array(e);for(let s=0;s<e;s++){let r=1;for(let i=0;i<t.length;i++)if(s<=t[i].maxDistance){r=t[i].weight;break}this.weightByDistance[s]=r}this.lastCameraBin=-1,this.lastBucketCount=-1}static computeCameraBin(e,t,s){let r=l.NUM_BINS;if(e)return r-1;let a=-t/s*r;return Math.max(0,Math.min(r-1,Math.floor(a)))}compute(e,t){if(e===this.lastCameraBin&&t===this.lastBucketCount)return this.binWeights;this.lastCameraBin=e,this.lastBucketCount=t;let s=l.NUM_BINS,r=this.bitsPerBin;for(let o=0;o<s;o++){let n=Math.abs(o-e);r[o]=this.weightByDistance[n]}let i=0;for(let o=0;o<s;o++)i+=r[o];let a=0;for(let o=0;o<s;o++){let n=Math.max(1,Math.floor(r[o]/i*t));this.binWeights[o*2]=a,this.binWeights[o*2+1]=n,a+=n}if(a>t){let o=a-t,n=(s-1)*2+1;this.binWeights[n]=Math.max(1,this.binWeights[n]-o)}return this.binWeights}};var kD,yp=new Set,af=class extends de{worker;bufferLength=0;availableOrderData=[];jobsInFlight=0;hasNewVersion=!1;pendingSorted=null;centersSet=new Set;_destroyed=!1;scene=null;constructor(e){super(),this.scene=e??null;let t=Oe.environment==="node"?'require("node:worker_threads").parentPort':"self",s=`
						const GSplatSortBinWeights = ${Tr.toString()};
						(${ix.toString()})(${t})
				`;Oe.environment==="node"?(this.worker=new Worker(s,{eval:!0}),this.worker.on("message",this.onSorted.bind(this))):(this.worker=new Worker(kD??=URL.createObjectURL(new Blob([s],{type:"application/javascript"}))),this.worker.addEventListener("message",this.onSorted.bind(this)))}onSorted(e){if(this._destroyed)return;let t=e.data??e;this.scene&&t.sortTime!==void 0&&this.scene.fire("gsplat:sorted",t.sortTime);let s=new Uint32Array(t.order);this.jobsInFlight--,this.pendingSorted&&this.releaseOrderData(this.pendingSorted.orderData),this.pendingSorted={count:t.count,version:t.version,orderData:s}}applyPendingSorted(){if(this.pendingSorted){let{count:e,version:t,orderData:s}=this.pendingSorted;this.pendingSorted=null,this.fire("sorted",e,t,s),this.releaseOrderData(s)}}releaseOrderData(e){e.length===this.bufferLength&&this.availableOrderData.push(e)}destroy(){this._destroyed=!0,this.pendingSorted=null,this.worker.terminate(),this.worker=null}setCenters(e,t){if(t){if(!this.centersSet.has(e)){this.centersSet.add(e);let s=t.buffer.slice();this.worker.postMessage({command:"addCenters",id:e,centers:s},[s])}}else this.centersSet.has(e)&&(this.centersSet.delete(e),this.worker.postMessage({command:"removeCenters",id:e}))}updateCentersForSplats(e){for(let t of e){let s=t.resource.id;yp.add(s),this.centersSet.has(s)||this.setCenters(s,t.resource.centers)}for(let t of this.centersSet)yp.has(t)||this.setCenters(t,null);yp.clear()}setSortParameters(e){this.hasNewVersion=!0;let{textureSize:t}=e,s=t*t;s!==this.bufferLength&&(this.bufferLength=s,this.availableOrderData.length=0),this.worker.postMessage(e)}setSortParams(e,t){if(this.hasNewVersion||this.jobsInFlight===0){let s=this.availableOrderData.pop();s||(s=new Uint32Array(this.bufferLength)),this.jobsInFlight++,this.hasNewVersion=!1,this.worker.postMessage({command:"sort",sortParams:e,radialSorting:t,order:s.buffer},[s.buffer])}}};var Cp=class{_offset=0;_size=0;_free=!0;_prev=null;_next=null;_prevFree=null;_nextFree=null;_bucket=-1;get offset(){return this._offset}get size(){return this._size}},of=class{_headAll=null;_tailAll=null;_freeBucketHeads=[];_pool=[];_capacity=0;_usedSize=0;_freeSize=0;_freeRegionCount=0;_growMultiplier;constructor(e=0,t=1.1){if(this._growMultiplier=t,e>0){this._capacity=e,this._freeSize=e;let s=this._obtain(0,e,!0);this._headAll=s,this._tailAll=s,this._addToBucket(s)}}get capacity(){return this._capacity}get usedSize(){return this._usedSize}get freeSize(){return this._freeSize}get fragmentation(){return this._freeSize>0?1-1/this._freeRegionCount:0}_bucketFor(e){return 31-Math.clz32(e)}_addToBucket(e){let t=this._bucketFor(e._size);for(e._bucket=t;t>=this._freeBucketHeads.length;)this._freeBucketHeads.push(null);e._prevFree=null,e._nextFree=this._freeBucketHeads[t],this._freeBucketHeads[t]&&(this._freeBucketHeads[t]._prevFree=e),this._freeBucketHeads[t]=e,this._freeRegionCount++}_removeFromBucket(e){let t=e._bucket;e._prevFree?e._prevFree._nextFree=e._nextFree:this._freeBucketHeads[t]=e._nextFree,e._nextFree&&(e._nextFree._prevFree=e._prevFree),e._prevFree=null,e._nextFree=null,e._bucket=-1,this._freeRegionCount--}_rebucket(e){this._bucketFor(e._size)!==e._bucket&&(this._removeFromBucket(e),this._addToBucket(e))}_obtain(e,t,s){let r;return this._pool.length>0?r=this._pool.pop():r=new Cp,r._offset=e,r._size=t,r._free=s,r._prev=null,r._next=null,r._prevFree=null,r._nextFree=null,r._bucket=-1,r}_release(e){e._prev=null,e._next=null,e._prevFree=null,e._nextFree=null,e._bucket=-1,this._pool.push(e)}_insertAfterInMainList(e,t){t===null?(e._prev=null,e._next=this._headAll,this._headAll&&(this._headAll._prev=e),this._headAll=e,this._tailAll||(this._tailAll=e)):(e._prev=t,e._next=t._next,t._next&&(t._next._prev=e),t._next=e,this._tailAll===t&&(this._tailAll=e))}_removeFromMainList(e){e._prev?e._prev._next=e._next:this._headAll=e._next,e._next?e._next._prev=e._prev:this._tailAll=e._prev,e._prev=null,e._next=null}_findFreeBlock(e){let t=this._bucketFor(e),s=this._freeBucketHeads.length;if(t<s){let r=null,i=this._freeBucketHeads[t];for(;i&&!(i._size>=e&&(!r||i._size<r._size)&&(r=i,i._size===e));)i=i._nextFree;if(r)return r}for(let r=t+1;r<s;r++)if(this._freeBucketHeads[r])return this._freeBucketHeads[r];return null}allocate(e){let t=this._findFreeBlock(e);if(!t)return null;if(this._usedSize+=e,this._freeSize-=e,t._size===e)return t._free=!1,this._removeFromBucket(t),t;let s=this._obtain(t._offset,e,!1);return t._offset+=e,t._size-=e,this._rebucket(t),this._insertAfterInMainList(s,t._prev),s}free(e){e._free=!0,this._usedSize-=e._size,this._freeSize+=e._size;let t=e._prev,s=e._next,r=t&&t._free,i=s&&s._free;r&&i?(t._size+=e._size+s._size,this._removeFromMainList(e),this._removeFromMainList(s),this._removeFromBucket(s),this._release(e),this._release(s),this._rebucket(t)):r?(t._size+=e._size,this._removeFromMainList(e),this._release(e),this._rebucket(t)):i?(e._size+=s._size,this._removeFromMainList(s),this._removeFromBucket(s),this._release(s),this._addToBucket(e)):this._addToBucket(e)}grow(e){if(e<=this._capacity)return;let t=e-this._capacity;if(this._capacity=e,this._freeSize+=t,this._tailAll&&this._tailAll._free)this._tailAll._size+=t,this._rebucket(this._tailAll);else{let s=this._obtain(this._capacity-t,t,!0);this._insertAfterInMainList(s,this._tailAll),this._addToBucket(s)}}defrag(e=0,t=new Set){return t.clear(),this._freeRegionCount===0||(e===0?this._defragFull(t):this._defragIncremental(e,t)),t}_defragFull(e){for(let i=0;i<this._freeBucketHeads.length;i++){let a=this._freeBucketHeads[i];for(;a;){let o=a._nextFree;this._removeFromMainList(a),a._prevFree=null,a._nextFree=null,a._bucket=-1,this._pool.push(a),a=o}this._freeBucketHeads[i]=null}this._freeRegionCount=0;let t=0,s=this._headAll;for(;s;)s._offset!==t&&(s._offset=t,e.add(s)),t+=s._size,s=s._next;let r=this._capacity-t;if(r>0){let i=this._obtain(t,r,!0);this._insertAfterInMainList(i,this._tailAll),this._addToBucket(i)}}_defragIncremental(e,t){let s=Math.ceil(e/2),r=e-s;for(let a=0;a<s;a++){let o=this._tailAll;for(;o&&o._free;)o=o._prev;if(!o)break;let n=this._findFreeBlock(o._size);if(!n||n._offset>=o._offset)break;this._moveBlock(o,n),t.add(o)}let i=this._headAll;for(let a=0;a<r&&i;){let o=i._next;if(i._free&&o&&!o._free){let n=o,c=i;n._offset=c._offset,c._offset=n._offset+n._size;let h=c._prev,d=n._next;if(n._prev=h,n._next=c,c._prev=n,c._next=d,h?h._next=n:this._headAll=n,d?d._prev=c:this._tailAll=c,c._next&&c._next._free){let f=c._next;c._size+=f._size,this._removeFromMainList(f),this._removeFromBucket(f),this._release(f),this._rebucket(c)}t.add(n),a++,i=c._next}else i=o}}_moveBlock(e,t){let s=e._size,r=t._offset,i=e._prev;this._removeFromMainList(e);let a=this._obtain(e._offset,s,!0);if(this._insertAfterInMainList(a,i),this._addToBucket(a),a._next&&a._next._free){let o=a._next;a._size+=o._size,this._removeFromMainList(o),this._removeFromBucket(o),this._release(o),this._rebucket(a)}if(a._prev&&a._prev._free){let o=a._prev;o._size+=a._size,this._removeFromMainList(a),this._removeFromBucket(a),this._release(a),this._rebucket(o)}if(e._offset=r,t._size===s){let o=t._prev;this._removeFromMainList(t),this._removeFromBucket(t),this._release(t),this._insertAfterInMainList(e,o)}else t._offset+=s,t._size-=s,this._rebucket(t),this._insertAfterInMainList(e,t._prev)}updateAllocation(e,t){for(let s=0;s<e.length;s++)this.free(e[s]);for(let s=0;s<t.length;s++){let r=t[s],i=this.allocate(r);if(i)t[s]=i;else{let a=r;for(let c=s+1;c<t.length;c++)a+=t[c];let o=this._usedSize+a,n=Math.ceil(o*this._growMultiplier);n>this._capacity&&this.grow(n),this.defrag(0);for(let c=s;c<t.length;c++){let h=t[c],d=this.allocate(h);t[c]=d}return!0}}return!1}};var GD=new k,vp=new Uint32Array(0),xp=[0,0],Wn=class{device;resource;node;lodIndex;placementId;allocId;parentPlacementId;numSplats;activeSplats=0;intervals=[];intervalOffsets=[];intervalAllocIds=[];intervalNodeIndices=[];previousWorldTransform=new N;aabb=new J;subDrawTexture=null;subDrawCount=0;numBoundsEntries=0;boundsBaseIndex=0;octreeNodes=null;nodeInfos=null;colorAccumulatedTranslation=0;parameters=null;getWorkBufferModifier=null;getInstanceStreams=null;_getDirtySource=null;_lastDirtyVersion=-1;_lastFormatVersion=-1;constructor(e,t,s,r=null,i=null){this.device=e,this.resource=t,this.node=s.node,this.lodIndex=s.lodIndex,this.placementId=s.id,this.allocId=s.allocId,this.parentPlacementId=r&&s.parentPlacement?s.parentPlacement.allocId:s.allocId,this.numSplats=t.numSplats,this.aabb.copy(s.aabb),this.parameters=s.parameters,this.getWorkBufferModifier=()=>s.workBufferModifier,this.getInstanceStreams=()=>s.streams,this._getDirtySource=()=>s.parentPlacement??s,this.octreeNodes=r,this.nodeInfos=i,this.updateIntervals(s.intervals)}destroy(){this.intervals.length=0,this.intervalOffsets.length=0,this.intervalAllocIds.length=0,this.intervalNodeIndices.length=0,this.subDrawTexture?.destroy(),this.subDrawTexture=null,this.subDrawCount=0}setLayout(e){this.intervalOffsets=e,this.subDrawTexture?.destroy(),this.subDrawTexture=null,this.subDrawCount=0}ensureSubDrawTexture(e){!this.subDrawTexture&&e>0&&this.updateSubDraws(e)}updateIntervals(e){let t=this.resource;if(this.intervals.length=0,this.intervalAllocIds.length=0,this.intervalNodeIndices.length=0,this.activeSplats=t.numSplats,e.size>0){let s=0,r=0;this.intervals.length=e.size*2;for(let[i,a]of e)this.intervals[r++]=a.x,this.intervals[r++]=a.y+1,s+=a.y-a.x+1,this.nodeInfos&&(this.intervalAllocIds.push(this.nodeInfos[i].allocId),this.intervalNodeIndices.push(i));this.octreeNodes?(this.activeSplats=s,this.numBoundsEntries=this.octreeNodes.length):s===this.numSplats?this.intervals.length=0:this.activeSplats=s}else{this.numBoundsEntries=1,this.intervalAllocIds.push(this.allocId);let s=t.maxSplats;s&&this.activeSplats<s&&(this.intervals[0]=0,this.intervals[1]=this.activeSplats)}}appendSubDraws(e,t,s,r,i,a){let o=r,n=i/a|0,c=i%a;if(c>0){let d=Math.min(o,a-c),f=t*4;e[f]=n|65536,e[f+1]=c,e[f+2]=c+d,e[f+3]=s,t++,s+=d,o-=d,n++}let h=o/a|0;if(h>0){let d=t*4;e[d]=n|h<<16,e[d+1]=0,e[d+2]=a,e[d+3]=s,t++,s+=h*a,o-=h*a,n+=h}if(o>0){let d=t*4;e[d]=n|65536,e[d+1]=0,e[d+2]=o,e[d+3]=s,t++}return t}updateSubDraws(e){let t=this.intervals,s=t.length/2;s===0&&(xp[0]=0,xp[1]=this.activeSplats,t=xp,s=1);let i=s*3*4;vp.length<i&&(vp=new Uint32Array(i));let a=vp,o=0;for(let d=0;d<s;d++)o=this.appendSubDraws(a,o,t[d*2],t[d*2+1]-t[d*2],this.intervalOffsets[d],e);this.subDrawCount=o;let{x:n,y:c}=et.calcTextureSize(o,GD);this.subDrawTexture=se.createDataTexture2D(this.device,"subDrawData",n,c,Je),this.subDrawTexture.lock().set(a.subarray(0,o*4)),this.subDrawTexture.unlock()}update(){let e=this.node.getWorldTransform(),t=!this.previousWorldTransform.equals(e);t&&this.previousWorldTransform.copy(e);let s=t,r=this._getDirtySource();this._lastDirtyVersion!==r.dirtyVersion&&(this._lastDirtyVersion=r.dirtyVersion,s=!0),r.workBufferUpdate===Vg&&(s=!0);let i=this.resource?.format;return i&&this._lastFormatVersion!==i.extraStreamsVersion&&(this._lastFormatVersion=i.extraStreamsVersion,s=!0),s}writeBoundsSpheres(e,t){if(this.octreeNodes)for(let s=0;s<this.octreeNodes.length;s++){let r=this.octreeNodes[s].boundingSphere;e[t++]=r.x,e[t++]=r.y,e[t++]=r.z,e[t++]=r.w}else{let s=this.resource.aabb,r=s.halfExtents,i=Math.sqrt(r.x*r.x+r.y*r.y+r.z*r.z);e[t++]=s.center.x,e[t++]=s.center.y,e[t++]=s.center.z,e[t++]=i}}get hasSphericalHarmonics(){return this.resource.gsplatData?.shBands>0}};var ax=`
#define GSPLAT_CENTER_NOPROJ
uniform vec3 model_scale;
uniform vec4 model_rotation;
#include "gsplatHelpersVS"
#include "gsplatFormatVS"
#include "gsplatStructsVS"
#include "gsplatDeclarationsVS"
#include "gsplatCenterVS"
#include "gsplatEvalSHVS"
#include "gsplatQuatToMat3VS"
#include "gsplatReadVS"
#include "gsplatWorkBufferGeometryPS"
#include "gsplatWorkBufferOutputVS"
#include "gsplatWriteVS"
#include "gsplatModifyVS"
flat varying ivec4 vSubDraw;
uniform vec3 uColorMultiply;
#if SH_BANDS > 0
	uniform uint uCameraOrtho;
#endif
#ifdef GSPLAT_ID
	uniform uint uId;
#endif
void main(void) {
	int localRow = int(gl_FragCoord.y) - vSubDraw.w;
	int localCol = int(gl_FragCoord.x) - vSubDraw.y;
	uint originalIndex = uint(vSubDraw.x + localRow * vSubDraw.z + localCol);
	setSplat(originalIndex);
	vec3 worldCenter;
	vec4 worldRotation = vec4(0.0, 0.0, 0.0, 1.0);
	vec3 worldScale = vec3(1.0);
	#if SH_BANDS > 0
		vec3 dir;
	#endif
	#ifdef GSPLAT_WORKBUFFER_GEOMETRY
		initWorkBufferGeometry(ivec2(gl_FragCoord.xy));
		worldCenter = workBufferWorldCenter();
		#if SH_BANDS > 0
			vec3 viewDir = uCameraOrtho != 0u ? vec3(0.0, 0.0, -1.0) * mat3(matrix_view) : worldCenter - uCameraPosition;
			dir = normalize(quatRotateInv(model_rotation, viewDir));
		#endif
	#else
		vec3 modelCenter = getCenter();
		worldCenter = (matrix_model * vec4(modelCenter, 1.0)).xyz;
		SplatCenter center;
		initCenter(modelCenter, center);
		vec4 srcRotation = getRotation().yzwx;
		vec3 srcScale = getScale();
		worldRotation = quatMul(model_rotation, srcRotation);
		if (worldRotation.w < 0.0) {
			worldRotation = -worldRotation;
		}
		worldScale = model_scale * srcScale;
		vec3 originalCenter = worldCenter;
		modifySplatCenter(worldCenter);
		modifySplatRotationScale(originalCenter, worldCenter, worldRotation, worldScale);
		#if SH_BANDS > 0
			vec3 viewDir = uCameraOrtho != 0u ? vec3(0.0, 0.0, -1.0) : center.view;
			dir = normalize(viewDir * mat3(center.modelView));
		#endif
	#endif
	vec4 color = getColor();
	#if SH_BANDS > 0
		vec3 sh[SH_COEFFS];
		float scale;
		readSHData(sh, scale);
		color.xyz += evalSH(sh, dir) * scale;
	#endif
	modifySplatColor(worldCenter, color);
	color.xyz *= uColorMultiply;
	writeSplat(worldCenter, worldRotation, worldScale, color);
	#ifdef GSPLAT_ID
		writePcId(uvec4(uId, 0u, 0u, 0u));
	#endif
}
`;var ox=`
attribute vec2 vertex_position;
precision highp usampler2D;
uniform usampler2D uSubDrawData;
uniform ivec2 uTextureSize;
uniform int uSubDrawBase;
flat varying ivec4 vSubDraw;
void main(void) {
	int subDrawWidth = textureSize(uSubDrawData, 0).x;
	int idx = gl_InstanceID + uSubDrawBase;
	uvec4 data = texelFetch(uSubDrawData, ivec2(idx % subDrawWidth, idx / subDrawWidth), 0);
	int rowStart = int(data.r & 0xFFFFu);
	int numRows = int(data.r >> 16u);
	int colStart = int(data.g);
	int colEnd = int(data.b);
	int sourceBase = int(data.a);
	float u = float(gl_VertexID & 1);
	float v = float(gl_VertexID >> 1);
	vec4 ndc = vec4(colStart, colEnd, rowStart, rowStart + numRows) / vec4(uTextureSize.x, uTextureSize.x, uTextureSize.y, uTextureSize.y) * 2.0 - 1.0;
	gl_Position = vec4(mix(ndc.x, ndc.y, u), mix(ndc.z, ndc.w, v), 0.5, 1.0);
	vSubDraw = ivec4(sourceBase, colStart, colEnd - colStart, rowStart);
}
`;var nx=new N,lx=new ai,Ap=8,nf=class{device;boundsBuffer=null;totalBoundsEntries=0;_allocatedBoundsEntries=0;_boundsFloatView=null;_boundsUintView=null;_tmpSpheres=null;transformsBuffer=null;_allocatedTransformCount=0;_transformsData=null;frustumPlanes=new Float32Array(24);fisheyeCameraPos=new Float32Array(3);fisheyeCameraForward=new Float32Array(3);fisheyeMaxTheta=Math.PI;constructor(e){this.device=e}destroy(){this.boundsBuffer?.destroy(),this.transformsBuffer?.destroy()}updateBoundsData(e){let t=0;for(let a=0;a<e.length;a++)t+=e[a].numBoundsEntries;if(this.totalBoundsEntries=t,t===0)return;if(t>this._allocatedBoundsEntries){this.boundsBuffer?.destroy(),this._allocatedBoundsEntries=t,this.boundsBuffer=new re(this.device,t*Ap*4,8);let a=new ArrayBuffer(t*Ap*4);this._boundsFloatView=new Float32Array(a),this._boundsUintView=new Uint32Array(a),this._tmpSpheres=new Float32Array(t*4)}let s=this._boundsFloatView,r=this._boundsUintView,i=this._tmpSpheres;for(let a=0;a<e.length;a++){let o=e[a],n=o.boundsBaseIndex,c=o.numBoundsEntries;o.splat.writeBoundsSpheres(i,n*4);for(let h=0;h<c;h++){let d=(n+h)*4,f=(n+h)*Ap;s[f+0]=i[d+0],s[f+1]=i[d+1],s[f+2]=i[d+2],s[f+3]=i[d+3],r[f+4]=a}}this.boundsBuffer.write(0,s)}updateTransformsData(e){let t=e.length;if(t===0)return;t>this._allocatedTransformCount&&(this.transformsBuffer?.destroy(),this._allocatedTransformCount=t,this.transformsBuffer=new re(this.device,t*12*4,8),this._transformsData=new Float32Array(t*12));let s=this._transformsData,r=0;for(let i=0;i<e.length;i++){let a=e[i].splat.node.getWorldTransform().data;s[r++]=a[0],s[r++]=a[4],s[r++]=a[8],s[r++]=a[12],s[r++]=a[1],s[r++]=a[5],s[r++]=a[9],s[r++]=a[13],s[r++]=a[2],s[r++]=a[6],s[r++]=a[10],s[r++]=a[14]}this.transformsBuffer.write(0,s)}setFrustumPlanes(e){this.frustumPlanes.set(e.planeData)}computeFrustumPlanes(e,t){nx.mul2(e,t),lx.setFromMat4(nx),this.setFrustumPlanes(lx)}setFisheyeData(e,t,s){this.fisheyeCameraPos[0]=e.x,this.fisheyeCameraPos[1]=e.y,this.fisheyeCameraPos[2]=e.z,this.fisheyeCameraForward[0]=t.x,this.fisheyeCameraForward[1]=t.y,this.fisheyeCameraForward[2]=t.z,this.fisheyeMaxTheta=s}};var VD=new N,cx=new N,lf=new y,bi=new fe,Rp=new k,zD=[1,1,1],Xn=class extends ft{splats=[];colorsByLod=void 0;cameraNode=null;workBuffer;colorOnly;_usesWorkBufferGeometry=!1;_modelScaleData=new Float32Array(3);_modelRotationData=new Float32Array(4);_cameraPositionData=new Float32Array(3);_textureSize=new Int32Array(2);_subDrawTexture;_partialData=[];constructor(e,t,s=!1){super(e),this.workBuffer=t,this.colorOnly=s,this._subDrawTexture=se.createDataTexture2D(e,"GsplatSubDrawData",1,1,Je)}destroy(){this.splats.length=0,this._subDrawTexture.destroy(),super.destroy()}init(e){super.init(e),this.colorOps.clear=!1,this.depthStencilOps.clearDepth=!1}update(e,t,s,r=null){this.splats.length=0,this._partialData.length=0,this.colorsByLod=s;let i=this.workBuffer.textureSize;if(r){let o=r.size*3;this._subDrawTexture.width*this._subDrawTexture.height<o&&(et.calcTextureSize(o,Rp),this._subDrawTexture.resize(Rp.x,Rp.y));let n=this._subDrawTexture.lock(),c=0;for(let h=0;h<e.length;h++){let d=e[h];if(d.activeSplats<=0)continue;let f=d.intervals,u=f.length/2;if(u===0)r.has(d.allocId)&&(this.splats.push(d),this._partialData.push(0,0));else{let m=c,_=d.intervalAllocIds;for(let g=0;g<u;g++)r.has(_[g])&&(c=d.appendSubDraws(n,c,f[g*2],f[g*2+1]-f[g*2],d.intervalOffsets[g],i));let p=c-m;p>0&&(this.splats.push(d),this._partialData.push(m,p))}}this._subDrawTexture.unlock()}else for(let o=0;o<e.length;o++){let n=e[o];n.activeSplats>0&&(this.splats.push(n),this._partialData.push(0,0))}let a=!1;for(let o=0;o<this.splats.length;o++)this._partialData[o*2+1]===0&&this.splats[o].ensureSubDrawTexture(i),a||(a=this.splats[o].resource.supportsWorkBufferGeometry);return this._usesWorkBufferGeometry=a,this.cameraNode=t,this.splats.length>0}execute(){let{device:e,splats:t,cameraNode:s,_partialData:r}=this;e.setDrawStates();let i=s.getWorldTransform(),a=VD.copy(i).invert();e.scope.resolve("matrix_view").setValue(a.data);let o=s.camera.projection===Bt;if(e.scope.resolve("uCameraOrtho").setValue(o?1:0),this.colorOnly&&this._usesWorkBufferGeometry){e.scope.resolve("uWorkBufferTransformA").setValue(this.workBuffer.getTexture("dataTransformA")),e.scope.resolve("uWorkBufferTransformB").setValue(this.workBuffer.getTexture("dataTransformB"));let n=s.getPosition();this._cameraPositionData[0]=n.x,this._cameraPositionData[1]=n.y,this._cameraPositionData[2]=n.z,e.scope.resolve("uCameraPosition").setValue(this._cameraPositionData)}for(let n=0;n<t.length;n++){let c=r[n*2+1];c>0?this.renderSplat(t[n],this._subDrawTexture,c,r[n*2]):this.renderSplat(t[n])}}renderSplat(e,t,s,r=0){let{device:i,resource:a}=e,o=i.scope,n=t??e.subDrawTexture,c=s??e.subDrawCount,h=e.getWorkBufferModifier?.()??null,d=a.format.hash,f=a.format.getInputDeclarations(),u=this.workBuffer.getRenderInfo(a,this.colorOnly,h,d,f);u.material.setParameters(i);let m=this.colorsByLod?.[e.lodIndex]??this.colorsByLod?.[0]??zD;o.resolve("uColorMultiply").setValue(m);let _=e.node.getWorldTransform();if(_.getScale(lf),bi.setFromMat4(_),bi.w<0&&bi.mulScalar(-1),this._modelScaleData[0]=lf.x,this._modelScaleData[1]=lf.y,this._modelScaleData[2]=lf.z,this._modelRotationData[0]=bi.x,this._modelRotationData[1]=bi.y,this._modelRotationData[2]=bi.z,this._modelRotationData[3]=bi.w,o.resolve("matrix_model").setValue(_.data),o.resolve("model_scale").setValue(this._modelScaleData),o.resolve("model_rotation").setValue(this._modelRotationData),this.colorOnly&&a.supportsWorkBufferGeometry&&(cx.copy(_).invert(),o.resolve("matrix_model_inverse").setValue(cx.data)),o.resolve("uId").setValue(e.placementId),e.parameters)for(let T of e.parameters.values())T.scopeId.setValue(T.data);let p=e.getInstanceStreams?.();if(p){p.syncWithFormat(e.resource.format);for(let[T,S]of p.textures)o.resolve(T).setValue(S)}o.resolve("uSubDrawData").setValue(n),o.resolve("uSubDrawBase").setValue(r);let g=this.workBuffer.textureSize;this._textureSize[0]=g,this._textureSize[1]=g,o.resolve("uTextureSize").setValue(this._textureSize),u.quadRender.render(void 0,void 0,c)}};var HD=0,ti=new Map,Pp=class{material;quadRender;constructor(e,t,s,r,i){this.material=s;let a=new Map(s.defines),o=i.getStream("dataColor");o.format===_t&&a.set("GSPLAT_COLOR_UINT",""),r&&a.set("GSPLAT_COLOR_ONLY",""),i.getStream("pcId")&&a.set("GSPLAT_ID","");let n=s.hasShaderChunks?e.isWebGPU?s.shaderChunks.wgsl:s.shaderChunks.glsl:void 0,c=r?[o]:[...i.streams,...i.extraStreams],h=[];for(let m of c){let _=ji(m.format);h.push(_.returnType)}let d=a.has("GSPLAT_LOD"),f={uniqueName:`SplatCopyToWorkBuffer:${t}`,attributes:{vertex_position:le},vertexDefines:a,fragmentDefines:a,fragmentGLSL:ax,fragmentWGSL:"",fragmentIncludes:n,fragmentOutputTypes:h};d?(f.vertexGLSL=ox,f.vertexWGSL=""):f.vertexChunk="fullscreenQuadVS";let u=ot.createShader(e,f);this.quadRender=new fr(u)}destroy(){this.material?.destroy(),this.quadRender?.destroy()}},Yn=class{device;format;id=HD++;streams;renderTarget;colorRenderTarget;orderTexture;orderBuffer;uploadStream;renderPass;colorRenderPass;frustumCuller;constructor(e,t){this.device=e,this.format=t,this.frustumCuller=new nf(e),this.streams=new Sr(e),this.streams.init(t,1),this._createRenderTargets(),this.uploadStream=new to(e,!e.isWebGPU),e.isWebGPU?this.orderBuffer=new re(e,4,8):this.orderTexture=new se(e,{name:"SplatGlobalOrder",width:1,height:1,format:xt,mipmaps:!1,addressU:1,addressV:1}),this.renderPass=new Xn(e,this),this.renderPass.init(this.renderTarget),this.colorRenderPass=new Xn(e,this,!0),this.colorRenderPass.init(this.colorRenderTarget)}getRenderInfo(e,t,s,r,i){let a=this.format;e.configureMaterialDefines(ti),ti.set("GSPLAT_LOD",""),t&&(ti.set("GSPLAT_COLOR_ONLY",""),e.supportsWorkBufferGeometry&&(ti.set("GSPLAT_WORKBUFFER_GEOMETRY",""),a.dataFormat===Ba&&ti.set("GSPLAT_WORKBUFFER_COMPACT","")));let o="";for(let[h,d]of ti)o&&(o+=";"),o+=`${h}=${d}`;let n=`${r};${a.hash};${s?.hash??0};${o}`,c=e.workBufferRenderInfos.get(n);if(!c){let h=new st;e.configureMaterial(h,s,i);let d=this.device.isWebGPU?h.shaderChunks.wgsl:h.shaderChunks.glsl,f=t?[a.getStream("dataColor")]:[...a.streams,...a.extraStreams],u=a.getOutputDeclarations(f);t&&a.extraStreams.length>0&&(u+=`
${a.getOutputStubs(a.extraStreams)}`),d.set("gsplatWorkBufferOutputVS",u);let m=a.getWriteCode();m&&d.set("gsplatWriteVS",m),ti.forEach((_,p)=>h.setDefine(p,_)),c=new Pp(this.device,n,h,t,a),e.workBufferRenderInfos.set(n,c)}return ti.clear(),c}_createRenderTargets(){this.renderTarget?.destroy(),this.colorRenderTarget?.destroy();let e=this.streams.getTexturesInOrder();this.renderTarget=new Le({name:`GsplatWorkBuffer-MRT-${this.id}`,colorBuffers:e,depth:!1,origin:pt});let t=this.streams.getTexture("dataColor");this.colorRenderTarget=new Le({name:`GsplatWorkBuffer-Color-${this.id}`,colorBuffer:t,depth:!1,origin:pt}),this.renderPass?.init(this.renderTarget),this.colorRenderPass?.init(this.colorRenderTarget)}syncWithFormat(){let e=this.streams._formatVersion;this.streams.syncWithFormat(this.format),e!==this.streams._formatVersion&&this._createRenderTargets()}getTexture(e){return this.streams.getTexture(e)}destroy(){this.renderPass?.destroy(),this.colorRenderPass?.destroy(),this.streams.destroy(),this.orderTexture?.destroy(),this.orderBuffer?.destroy(),this.renderTarget?.destroy(),this.colorRenderTarget?.destroy(),this.uploadStream.destroy(),this.frustumCuller.destroy()}get textureSize(){return this.streams.textureDimensions.x}setOrderData(e){let t=this.textureSize;this.device.isWebGPU?this.uploadStream.upload(e,this.orderBuffer,0,e.length):this.uploadStream.upload(e,this.orderTexture,0,e.length)}resize(e){if(this.renderTarget.resize(e,e),this.colorRenderTarget.resize(e,e),this.streams.resize(e,e),this.device.isWebGPU){let t=e*e*4;this.orderBuffer.byteSize<t&&(this.orderBuffer.destroy(),this.orderBuffer=new re(this.device,t,8))}else this.orderTexture.resize(e,e)}render(e,t,s,r=null){this.renderPass.update(e,t,s,r)&&this.renderPass.render()}renderColor(e,t,s,r=null){this.colorRenderPass.update(e,t,s,r)&&this.colorRenderPass.render()}};var cf=new za;var Fi=class{resource;node;intervals=new Map;id=0;allocId=cf.get();lodIndex=0;_lodRangeMin=0;_lodRangeMax=99;_lodBaseDistance=5;_lodMultiplier=3;set lodBaseDistance(e){this._lodBaseDistance!==e&&(this._lodBaseDistance=e,this.lodDirty=!0)}get lodBaseDistance(){return this._lodBaseDistance}set lodMultiplier(e){this._lodMultiplier!==e&&(this._lodMultiplier=e,this.lodDirty=!0)}get lodMultiplier(){return this._lodMultiplier}set lodRangeMin(e){this._lodRangeMin!==e&&(this._lodRangeMin=e,this.lodDirty=!0)}get lodRangeMin(){return this._lodRangeMin}set lodRangeMax(e){this._lodRangeMax!==e&&(this._lodRangeMax=e,this.lodDirty=!0)}get lodRangeMax(){return this._lodRangeMax}_aabb=null;parameters=null;_streams=null;lodDirty=!1;dirtyVersion=0;_workBufferUpdate=Qc;_workBufferModifier=null;parentPlacement=null;constructor(e,t,s=0,r=null,i=null,a=null){this.id=a??i?.id??0,this.resource=e,this.node=t,this.lodIndex=s,this.parameters=r??i?.parameters??null,this.parentPlacement=i}destroy(){this._streams?.destroy(),this._streams=null,this.intervals.clear(),this.resource=null}set workBufferModifier(e){this._workBufferModifier=e,this.dirtyVersion++}get workBufferModifier(){return this.parentPlacement?.workBufferModifier??this._workBufferModifier}set workBufferUpdate(e){e===Ri?this.dirtyVersion++:this._workBufferUpdate=e}get workBufferUpdate(){return this._workBufferUpdate}markDirty(){this.dirtyVersion++}set aabb(e){this._aabb=e?.clone()??null}get aabb(){return this._aabb??this.resource?.aabb}getInstanceTexture(e,t){let s=this.resource;if(s?.format)return!this._streams&&s.format.instanceStreams.length>0&&(this._streams=new Sr(t,!0),this._streams.textureDimensions.copy(s.streams.textureDimensions),this._streams.syncWithFormat(s.format)),this._streams?.getTexture(e)}get streams(){return this.parentPlacement?.streams??this._streams}ensureInstanceStreams(e){let t=this.resource;t?.format&&!this._streams&&t.format.instanceStreams.length>0&&(this._streams=new Sr(e,!0),this._streams.textureDimensions.copy(t.streams.textureDimensions),this._streams.syncWithFormat(t.format))}};var Dp=new N,WD=new y,XD=new y,si=[],F7=new J,YD=Math.tan(22.5*O.DEG_TO_RAD),hx=0,jD=1,qD=2,O7=[new z(1,0,0),new z(0,1,0),new z(0,0,1),new z(1,1,0),new z(1,0,1)],Ip=class{currentLod=-1;optimalLod=-1;worldDistanceSq=0;colorAccumulatedTranslation=0;inst=null;allocId=cf.get();resetLod(){this.currentLod=-1,this.optimalLod=-1}},hf=class{octree;placement;activePlacements=new Set;dirtyModifiedPlacements=!1;dirtyPlacementSetChanged=!1;device;nodeInfos;filePlacements;pending=new Set;pendingDecrements=new Map;removedCandidates=new Set;rangeMin=0;rangeMax=0;lodTable=null;previousPosition=new y;needsLodUpdate=!1;prefetchPending=new Set;_fileRequests=new Map;pendingVisibleAdds=new Map;get pendingLoadCount(){let e=this.pending.size+this.prefetchPending.size;return this.octree.environmentUrl&&!this.environmentPlacement&&e++,e}environmentPlacement=null;_deviceLostEvent=null;constructor(e,t,s){this.device=e,this.octree=t,this.placement=s,this.nodeInfos=new Array(t.nodes.length);for(let i=0;i<t.nodes.length;i++){let a=new Ip;a.inst=this,this.nodeInfos[i]=a}let r=t.files.length;this.filePlacements=new Array(r).fill(null),t.environmentUrl&&(t.incEnvironmentRefCount(),t.ensureEnvironmentResource()),this._deviceLostEvent=e.on("devicelost",this._onDeviceLost,this)}destroy(e=!1){if(this.octree&&!this.octree.destroyed&&(this.octree.releaseLodTable(this.lodTable),this.octree.removeRequests(this,!e)),this.lodTable=null,this._fileRequests.clear(),!e&&this.octree&&!this.octree.destroyed){let t=this.getFileDecrements();for(let s of t)this.octree.decRefCount(s,0);this.environmentPlacement&&this.octree.decEnvironmentRefCount()}this.pending.clear(),this.pendingDecrements.clear(),this.filePlacements.length=0,this.environmentPlacement&&(this.activePlacements.delete(this.environmentPlacement),this.environmentPlacement=null),this._deviceLostEvent?.off(),this._deviceLostEvent=null}_onDeviceLost(){for(let e=0;e<this.filePlacements.length;e++)this.filePlacements[e]&&this.octree.decRefCount(e,0);this.filePlacements.fill(null),this.activePlacements.clear(),this.pending.clear(),this.pendingDecrements.clear(),this.removedCandidates.clear(),this.prefetchPending.clear(),this.pendingVisibleAdds.clear();for(let e of this.nodeInfos)e.resetLod();this.environmentPlacement&&(this.activePlacements.delete(this.environmentPlacement),this.environmentPlacement=null,this.octree.unloadEnvironmentResource()),this.dirtyModifiedPlacements=!0,this.dirtyPlacementSetChanged=!0,this.needsLodUpdate=!0}getFileDecrements(){let e=[];for(let t=0;t<this.filePlacements.length;t++)this.filePlacements[t]&&e.push(t);return e}selectDesiredLodIndex(e,t,s){if(s>0&&t>=0){let r=this.lodTable,i=this.octree.nodes[e],a=r.findCoarserAccepted(e,t,s,c=>{let h=i.lods[c].fileIndex;return h===-1||!!this.octree.getFileResource(h)});if(a>=0)return a;let o=-1,n=t;for(let c=0;c<=s&&n>=0;c++)i.lods[n].fileIndex!==-1&&(o=n),n=r.coarserOnChain(e,n);if(o>=0)return o}return t}prefetchNextLod(e,t,s,r){if(t===-1||s===-1)return;let i=t===s?s:this.lodTable.finerOnChain(e,t);if(i<0)return;let a=this.octree.nodes[e].lods[i].fileIndex;a!==-1&&!this.requestFile(a,hx,r)&&this.prefetchPending.add(a)}requestFile(e,t,s){if(this.octree.pollFileResource(e))return!0;let r=this.octree,i=t+(r.files[e].lodLevel+s)/r.lodLevels,a=this._fileRequests.get(e);return(a===void 0||i>a)&&this._fileRequests.set(e,i),!1}resolveLodRange(){let e=this.octree.lodLevels-1,{lodRangeMin:t,lodRangeMax:s}=this.placement,r=Math.max(0,Math.min(t??0,e)),i=Math.max(r,Math.min(s??e,e));this.rangeMin=r,this.rangeMax=i;let a=this.lodTable;(!a||a.rangeMin!==r||a.rangeMax!==i)&&(this.lodTable=this.octree.acquireLodTable(r,i),this.octree.releaseLodTable(a))}evaluateNodeDistances(e,t){let{lodBehindPenalty:s}=t,r=t.lodDistanceShrink??0,i=this.octree.nodeBoundsExcess,a=this.placement.node.getWorldTransform().getScale().x,o=e.camera,n=o.projection===Bt,c=1;if(!n){let R=o.aspectRatio,w=R>0&&Number.isFinite(R)?R:1,M=Math.tan(o.fov*.5*O.DEG_TO_RAD);o.horizontalFov&&(M/=w);let P=M*w;c=Math.min(M,P)/YD}let h=e.getPosition(),d=this.placement.node.getWorldTransform();Dp.copy(d).invert();let f=Dp.transformPoint(h,WD),u=e.forward,m=Dp.transformVector(u,XD).normalize(),_=this.octree.nodes,p=this.nodeInfos,g=this.octree.nodeBoundsMinMax,T=c*a*(c*a),S=s>1?s-1:0,x=f.x,C=f.y,E=f.z,v=m.x,A=m.y,D=m.z;for(let R=0;R<_.length;R++){let w=p[R],M=R*6,P=g[M],L=g[M+3],G=g[M+1],U=g[M+4],F=g[M+2],Y=g[M+5];if(r>0){let He=R*3,ut=i[He]*r,Ct=i[He+1]*r,Ht=i[He+2]*r;P+=ut,L-=ut,G+=Ct,U-=Ct,F+=Ht,Y-=Ht}let K=x;K<P?K=P:K>L&&(K=L);let W=C;W<G?W=G:W>U&&(W=U);let ae=E;ae<F?ae=F:ae>Y&&(ae=Y);let H=K-x,ee=W-C,Ze=ae-E,he=H*H+ee*ee+Ze*Ze,j=1;if(S>0&&he>1e-4){let He=v*H+A*ee+D*Ze;He<0&&(j=1+-He/Math.sqrt(he)*S)}w.worldDistanceSq=he*j*j*T}}applyLodChanges(e){let t=this.octree,s=t.nodes,{lodUnderfillLimit:r=0}=e;this.prefetchPending.clear(),this._fileRequests.clear();for(let i=0;i<s.length;i++){let a=s[i],o=this.nodeInfos[i],n=o.optimalLod,c=o.currentLod,h=this.selectDesiredLodIndex(i,n,r);if(h!==c){let m=c>=0?a.lods[c].fileIndex:-1,_=h>=0?a.lods[h].fileIndex:-1,p=m!==-1,g=_!==-1,T=this.pendingDecrements.get(i);if(T&&T.newFileIndex!==_&&(this.filePlacements[T.newFileIndex]&&this.decrementFileRef(T.newFileIndex,i),p&&g?this.pendingDecrements.set(i,{oldFileIndex:T.oldFileIndex,newFileIndex:_}):this.pendingDecrements.delete(i)),!p&&g){let S=this.pendingVisibleAdds.get(i);S!==void 0&&S!==_&&(this.decrementFileRef(S,i),this.pendingVisibleAdds.delete(i)),this.incrementFileRef(_,i,h),this.filePlacements[_]?.resource?(o.currentLod=h,this.pendingVisibleAdds.delete(i)):this.pendingVisibleAdds.set(i,_)}else if(p&&!g){let S=this.pendingDecrements.get(i);S&&(this.decrementFileRef(S.newFileIndex,i),this.pendingDecrements.delete(i)),this.decrementFileRef(m,i),o.currentLod=-1,this.pendingVisibleAdds.delete(i)}else p&&g&&(this.incrementFileRef(_,i,h),this.filePlacements[_]?.resource?(this.decrementFileRef(m,i),this.pendingDecrements.delete(i),o.currentLod=h,this.pendingVisibleAdds.delete(i)):(this.pendingDecrements.set(i,{oldFileIndex:m,newFileIndex:_}),this.pendingVisibleAdds.delete(i)))}let d=1/(1+Math.max(o.worldDistanceSq,1e-12)),f=this.pendingVisibleAdds.get(i);f!==void 0&&this.requestFile(f,qD,d);let u=this.pendingDecrements.get(i);u&&this.requestFile(u.newFileIndex,jD,d),this.prefetchNextLod(i,h,n,d)}for(let i of this.pending)this.requestFile(i,hx,0);t.submitRequests(this,this._fileRequests)}incrementFileRef(e,t,s){if(e===-1)return;let r=this.filePlacements[e];r||(r=new Fi(null,this.placement.node,s,null,this.placement),this.filePlacements[e]=r,this.removedCandidates.delete(e)||this.octree.incRefCount(e),this.addFilePlacement(e)||this.pending.add(e));let o=this.octree.nodes[t].lods[s],n=new k(o.offset,o.offset+o.count-1);r.intervals.set(t,n),this.dirtyModifiedPlacements=!0}decrementFileRef(e,t){if(e===-1)return;let s=this.filePlacements[e];s&&s&&(s.intervals.delete(t),this.dirtyModifiedPlacements=!0,s.intervals.size===0&&(s.resource&&(this.activePlacements.delete(s),this.activePlacements.size===0&&(this.dirtyPlacementSetChanged=!0)),this.removedCandidates.add(e),this.filePlacements[e]=null,this.pending.delete(e)))}addFilePlacement(e){let t=this.octree.getFileResource(e);if(t){let s=this.filePlacements[e];if(s)return s.resource=t,this.activePlacements.size===0&&(this.dirtyPlacementSetChanged=!0),this.activePlacements.add(s),this.dirtyModifiedPlacements=!0,this.removedCandidates.delete(e),!0}return!1}testMoved(e){return this.placement.node.getPosition().distance(this.previousPosition)>e}updateMoved(){this.previousPosition.copy(this.placement.node.getPosition())}update(){if(this.placement.lodDirty&&(this.placement.lodDirty=!1,this.needsLodUpdate=!0),this.pending.size){for(let t of this.pending)if(this.octree.ensureFileResource(t),this.addFilePlacement(t)){si.push(t);for(let[s,{oldFileIndex:r,newFileIndex:i}]of this.pendingDecrements)if(i===t){this.decrementFileRef(r,s),this.pendingDecrements.delete(s);let a=0,o=this.octree.nodes[s].lods;for(let n=0;n<o.length;n++)if(o[n].fileIndex===i){a=n;break}this.nodeInfos[s].currentLod=a}}si.length>0&&(this.needsLodUpdate=!0);for(let t of si)this.pending.delete(t);si.length=0}if(this.pollPrefetchCompletions(),this.octree.environmentUrl&&!this.environmentPlacement){this.octree.ensureEnvironmentResource();let t=this.octree.environmentResource;t&&(this.environmentPlacement=new Fi(t,this.placement.node,0,null,this.placement),this.environmentPlacement.aabb.copy(t.aabb),this.activePlacements.add(this.environmentPlacement),this.dirtyModifiedPlacements=!0,this.dirtyPlacementSetChanged=!0,t.releaseTextureSources?.())}let e=this.dirtyModifiedPlacements;return this.dirtyModifiedPlacements=!1,e}consumePlacementSetChanged(){let e=this.dirtyPlacementSetChanged;return this.dirtyPlacementSetChanged=!1,e}debugRender(e){}consumeNeedsLodUpdate(){let e=this.needsLodUpdate;return this.needsLodUpdate=!1,e}pollPrefetchCompletions(){if(this.prefetchPending.size){for(let e of this.prefetchPending)this.octree.ensureFileResource(e),this.octree.getFileResource(e)&&si.push(e);si.length>0&&(this.needsLodUpdate=!0);for(let e of si)this.prefetchPending.delete(e);si.length=0}}};var dx=new y,fx=new y,df=class{lods;bounds=new J;boundingSphere=new ne;constructor(e,t){this.lods=e,dx.set(t.min[0],t.min[1],t.min[2]),fx.set(t.max[0],t.max[1],t.max[2]),this.bounds.setMinMax(dx,fx);let s=this.bounds.center,r=this.bounds.halfExtents,i=Math.sqrt(r.x*r.x+r.y*r.y+r.z*r.z);this.boundingSphere.set(s.x,s.y,s.z,i)}};var ff=class{rangeMin;rangeMax;span;refCount=0;bandLod;bandCount;totalCoarsestCount=0;totalFinestCount=0;constructor(e,t,s){this.rangeMin=t,this.rangeMax=s;let r=e.nodes,i=r.length,a=s-t+1;this.span=a;let o=new Int16Array(i*a),n=new Int32Array(i*a),c=0,h=0;for(let d=0;d<i;d++){let f=r[d].lods,u=d*a,m=-1;for(let p=s;p>=t;p--)if(f[p].count>0){m=p;break}if(m<0){o.fill(-1,u,u+a);continue}let _=m+1;for(let p=0;p<a;p++){let g=t+p,T=g;if(g>m)T=_;else if(f[g].count<=0){T=-1;for(let S=g-1;S>=t;S--)if(f[S].count>0){T=S;break}if(T<0){for(let S=g+1;S<=m;S++)if(f[S].count>0){T=S;break}}}o[u+p]=T,n[u+p]=T===_?0:f[T].count}h+=n[u],c+=n[u+a-1]}this.bandLod=o,this.bandCount=n,this.totalCoarsestCount=c,this.totalFinestCount=h}findCoarserAccepted(e,t,s,r){let i=this.bandLod,a=e*this.span,o=a+this.span,n=a;for(;n<o&&i[n]!==t;)n++;if(n===o)return-1;let c=0,h=-1;for(;n<o&&c<=s;n++){let d=i[n];if(d!==h){if(h>=0&&c++,c>s)break;if(r(d))return d;h=d}}return-1}coarserOnChain(e,t){let s=this.bandLod,r=e*this.span;for(let i=r,a=r+this.span;i<a;i++)if(s[i]>t)return s[i];return-1}finerOnChain(e,t){let s=this.bandLod,r=e*this.span;for(let i=r+this.span-1;i>=r;i--)if(s[i]>=0&&s[i]<t)return s[i];return-1}};var wp=[],jn=[],qn=new Map,uf=class l{nodes;nodeBoundsMinMax;nodeBoundsExcess;files;lodLevels;_lodTables=new Map;assetFileUrl;fileResources=new Map;fileRefCounts;cooldowns=new Map;_requesters=new Map;_changedRequests=new Set;_cooldownToken;environmentUrl=null;environmentResource=null;environmentRefCount=0;assetLoader=null;destroyed=!1;cooldownTicks=100;constructor(e,t){this.lodLevels=t.lodLevels,this.assetFileUrl=e;let s=oe.getDirectory(e);this.files=t.filenames.map(o=>({url:oe.isRelativePath(o)?oe.join(s,o):o,lodLevel:-1})),this.fileRefCounts=new Int32Array(this.files.length),t.environment&&(this.environmentUrl=oe.isRelativePath(t.environment)?oe.join(s,t.environment):t.environment);let r=[];this._extractLeafNodes(t.tree,r),this.nodes=r.map(o=>{let n=[];for(let c=0;c<this.lodLevels;c++){let h=o.lods[c.toString()];h?(n.push({file:this.files[h.file].url||"",fileIndex:(h.count||0)>0?h.file:-1,offset:h.offset||0,count:h.count||0}),this.files[h.file].lodLevel=c):n.push({file:"",fileIndex:-1,offset:0,count:0})}return new df(n,o.bound)});let i=this.nodes.length,a=new Float32Array(i*6);for(let o=0;o<i;o++){let n=this.nodes[o].bounds,c=n.getMin(),h=n.getMax(),d=o*6;a[d+0]=c.x,a[d+1]=c.y,a[d+2]=c.z,a[d+3]=h.x,a[d+4]=h.y,a[d+5]=h.z}this.nodeBoundsMinMax=a,this.nodeBoundsExcess=l._computeBoundsExcess(a,i)}static _computeBoundsExcess(e,t){let s=new Float32Array(t*3);if(t===0)return s;let r=new Float32Array(t);for(let i=0;i<3;i++){for(let n=0;n<t;n++)r[n]=(e[n*6+3+i]-e[n*6+i])*.5;let o=r.slice().sort()[t>>1];for(let n=0;n<t;n++)s[n*3+i]=Math.max(0,r[n]-o)}return s}destroy(){this.destroyed=!0,this._lodTables.clear(),this.fileResources.clear(),this.cooldowns.clear(),this._requesters.clear(),this._changedRequests.clear(),this.assetLoader?.destroy(),this.assetLoader=null,this.environmentResource=null}_traceLodCounts(){}acquireLodTable(e,t){let s=`${e},${t}`,r=this._lodTables.get(s);return r||(r=new ff(this,e,t),this._lodTables.set(s,r)),r.refCount++,r}releaseLodTable(e){e&&--e.refCount<=0&&this._lodTables.delete(`${e.rangeMin},${e.rangeMax}`)}_extractLeafNodes(e,t){if(e.lods)t.push({lods:e.lods,bound:e.bound});else if(e.children)for(let s of e.children)this._extractLeafNodes(s,t)}getFileResource(e){return this.fileResources.get(e)}incRefCount(e){let t=this.fileRefCounts[e]+1;this.fileRefCounts[e]=t,this.cooldowns.delete(e)}decRefCount(e,t){let s=this.fileRefCounts[e]-1;this.fileRefCounts[e]=s,s===0&&(t===0?this.unloadResource(e):this.cooldowns.set(e,t))}unloadResource(e){if(!this.assetLoader)return;let t=this.files[e].url;this.assetLoader.unload(t),this.fileResources.has(e)&&(this.fileResources.delete(e),this._traceLodCounts())}updateCooldownTick(e,t){if(t!==void 0){if(t===this._cooldownToken)return;this._cooldownToken=t}this.cooldownTicks=e,this.cooldowns.size>0&&(this.cooldowns.forEach((s,r)=>{s<=1?(this.fileRefCounts[r]===0&&this.unloadResource(r),wp.push(r)):this.cooldowns.set(r,s-1)}),wp.forEach(s=>this.cooldowns.delete(s)),wp.length=0)}pollFileResource(e){if(this.fileResources.has(e))return!0;if(!this.assetLoader)return!1;let t=this.assetLoader.getResource(this.files[e].url);return t?(this.fileResources.set(e,t),t.releaseTextureSources?.(),this.fileRefCounts[e]===0&&this.cooldowns.set(e,this.cooldownTicks),this._traceLodCounts(),!0):!1}ensureFileResource(e){!this.pollFileResource(e)&&this.assetLoader&&this.assetLoader.load(this.files[e].url)}submitRequests(e,t){let s=this._requesters.get(e);s||(s=new Map,this._requesters.set(e,s));let r=this._changedRequests;for(let i of s.keys())r.add(i);s.clear();for(let[i,a]of t)s.set(i,a),r.add(i)}removeRequests(e,t){let s=this._requesters.get(e);if(s){this._requesters.delete(e);for(let r of s.keys())if(!this.fileResources.has(r)){let i=this._getRequestPriority(r);i===void 0?(this._changedRequests.delete(r),this._withdrawRequest(r,t)):this.assetLoader?.load(this.files[r].url,i)}}}flushRequests(){let e=this._changedRequests;if(e.size===0)return;let t=this.assetLoader;if(t){for(let s of e)if(!this.fileResources.has(s)){let r=this._getRequestPriority(s);r===void 0?this._withdrawRequest(s,!1):(jn.push(s),qn.set(s,r))}jn.sort((s,r)=>qn.get(r)-qn.get(s));for(let s=0;s<jn.length;s++){let r=jn[s];this.fileRefCounts[r]===0&&this.cooldowns.delete(r),t.load(this.files[r].url,qn.get(r))}jn.length=0,qn.clear()}e.clear()}_getRequestPriority(e){let t;for(let s of this._requesters.values()){let r=s.get(e);r!==void 0&&(t===void 0||r>t)&&(t=r)}return t}_withdrawRequest(e,t){let s=this.assetLoader;!s||s.dequeue(this.files[e].url)||this.fileRefCounts[e]===0&&(t?this.unloadResource(e):this.cooldowns.has(e)||this.cooldowns.set(e,this.cooldownTicks))}incEnvironmentRefCount(){this.environmentRefCount++}decEnvironmentRefCount(){this.environmentRefCount--,this.environmentRefCount===0&&this.unloadEnvironmentResource()}ensureEnvironmentResource(){if(!this.assetLoader||!this.environmentUrl||this.environmentResource)return;let e=this.assetLoader.getResource(this.environmentUrl);if(e){this.environmentResource=e,this.environmentRefCount===0&&this.unloadEnvironmentResource();return}this.assetLoader.load(this.environmentUrl)}unloadEnvironmentResource(){this.assetLoader&&this.environmentResource&&this.environmentUrl&&(this.assetLoader.unload(this.environmentUrl),this.environmentResource=null)}};var mf=class{aabb=new J;centersVersion=0;octree;_numSplats=null;data;constructor(e,t,s){this.octree=new uf(e,t),this.octree.assetLoader=s,this.aabb.setMinMax(new y(t.tree.bound.min),new y(t.tree.bound.max)),this.data=t,this.data.tree=null}get numSplats(){if(this._numSplats===null){let e=0,t=this.octree?.nodes??[];for(let s=0;s<t.length;s++)e+=t[s].lods[0]?.count??0;this._numSplats=e}return this._numSplats}destroy(){this.octree?.destroy(),this.octree=null}};var Mp=new Set,Er=[],co=[],ho=[],pf=class{version=0;sortParametersSet=!1;sortedBefore=!1;splats=[];textureSize=0;totalActiveSplats=0;totalIntervals=0;boundsGroups=[];pendingReleases=[];needsUpload=[];needsUploadIds=new Set;allocIdToSplat=new Map;fullRebuild=!1;constructor(e,t,s,r,i){if(this.version=t,this.splats=s,s.length===0){for(let[,n]of i)r.free(n);i.clear(),this.totalActiveSplats=0,this.totalIntervals=0,this.textureSize=1;return}this.computeAllocationDiff(s,i);let{fullRebuild:a,changedAllocIds:o}=this.applyAllocations(e,r,i);this.assignSplatOffsets(s,i,a,o),this.buildBoundsGroups(s)}destroy(){this.splats.forEach(e=>e.destroy()),this.splats.length=0,this.needsUpload.length=0,this.needsUploadIds.clear(),this.allocIdToSplat.clear(),this.boundsGroups.length=0}computeAllocationDiff(e,t){for(let s=0;s<e.length;s++){let r=e[s],i=r.intervalAllocIds,a=r.intervals,o=a.length/2;if(o>0&&i.length===o)for(let n=0;n<o;n++)this._diffAlloc(i[n],a[n*2+1]-a[n*2],t);else this._diffAlloc(r.allocId,r.activeSplats,t)}for(let[s,r]of t)Mp.has(s)||(ho.push(r),t.delete(s))}_diffAlloc(e,t,s){Mp.add(e);let r=s.get(e);r?r.size!==t&&(ho.push(r),s.delete(e),t>0&&(Er.push(e),co.push(t))):t>0&&(Er.push(e),co.push(t))}applyAllocations(e,t,s){let r=!1;if(ho.length>0||co.length>0){r=t.updateAllocation(ho,co);for(let c=0;c<Er.length;c++)s.set(Er[c],co[c])}this.fullRebuild=r;let i=ho.length+Er.length,a=Math.max(50,i);if(!r&&t.fragmentation>.3){let c=t.defrag(a);if(c.size>0)for(let[h,d]of s)c.has(d)&&Er.push(h)}let o=t.capacity;this.textureSize=o>0?Math.ceil(Math.sqrt(o)):1;let n=Er.length>0?new Set(Er):null;return Mp.clear(),Er.length=0,co.length=0,ho.length=0,{fullRebuild:r,changedAllocIds:n}}assignSplatOffsets(e,t,s,r){let i=0,a=0;for(let o=0;o<e.length;o++){let n=e[o],c=n.intervalAllocIds,h=n.intervals,d=h.length/2;a+=d>0?d:1;let f=s,u=[];if(d>0&&c.length===d)for(let m=0;m<d;m++){this.allocIdToSplat.set(c[m],n);let _=t.get(c[m]);_&&(u.push(_.offset),i+=h[m*2+1]-h[m*2],r&&r.has(c[m])&&(f=!0,this.needsUploadIds.add(c[m])))}else{this.allocIdToSplat.set(n.allocId,n);let m=t.get(n.allocId);m&&(u.push(m.offset),i+=n.activeSplats,r&&r.has(n.allocId)&&(f=!0,this.needsUploadIds.add(n.allocId)))}if(u.length>0&&(n.setLayout(u),f&&(this.needsUpload.push(n),s)))for(let m=0;m<c.length;m++)this.needsUploadIds.add(c[m])}this.totalActiveSplats=i,this.totalIntervals=a}buildBoundsGroups(e){let t=new Map;for(let r=0;r<e.length;r++){let i=e[r],a=i.parentPlacementId;t.has(a)||t.set(a,{splat:i,boundsBaseIndex:0,numBoundsEntries:i.numBoundsEntries})}let s=0;for(let r of t.values())r.boundsBaseIndex=s,s+=r.numBoundsEntries,this.boundsGroups.push(r);for(let r=0;r<e.length;r++){let i=t.get(e[r].parentPlacementId);e[r].boundsBaseIndex=i.boundsBaseIndex}}};var _f=class{_states=new WeakMap;hasChanges(e){let t=!1;for(let s of e){if(!s.resource)continue;let r=s.resource.format?.extraStreamsVersion??0,i=s.workBufferModifier?.hash??0,a=s.resource.numSplats??0,o=s.resource.centersVersion,n=this._states.get(s);n?(n.formatVersion!==r||n.modifierHash!==i||n.numSplats!==a||n.centersVersion!==o)&&(n.formatVersion=r,n.modifierHash=i,n.numSplats=a,n.centersVersion=o,t=!0):(this._states.set(s,{formatVersion:r,modifierHash:i,numSplats:a,centersVersion:o}),t=!0)}return t}};var Lp=.00392156862745098,ux=1e6,Hs=1024,yr=1024;var _x=-48,$D=48,$n=Hs/($D-_x),gf=Hs-1,mx=yr-1,bp=Hs/2,px=1e-12,KD=$n*.5,Sf=class{_histogram=new Float64Array(Math.max(Hs,yr));_position=new Float64Array(0);balance(e,t,s){let r=0,i=0,a=0;for(let[,f]of e)r+=f.octree.nodes.length,i+=f.lodTable.totalCoarsestCount,a+=f.lodTable.totalFinestCount;if(r===0)return;if(i>=t){this._assignChainEnd(e,!1);return}if(!s&&a<=t){this._assignChainEnd(e,!0);return}this._position.length<r&&(this._position=new Float64Array(Math.max(r,this._position.length*2,1024)));let o=this._position,n=0,c=0;for(let[,f]of e){let{bandLod:u,bandCount:m,span:_}=f.lodTable,p=f.nodeInfos,g=Math.log(f.placement.lodMultiplier)*$n,T=(-Math.log(f.placement.lodBaseDistance)-_x)*$n-(f.rangeMin-1)*g;for(let S=0,x=p.length;S<x;S++){let C=S*_;if(u[C]<0)continue;let E=p[S].worldDistanceSq,v=Math.log(E>px?E:px)*KD+T;if(o[c+S]=v,s){let A=_-1;for(;A>0;){let D=v-A*g;if((D<0?0:D>=Hs?gf:D|0)>=bp)break;A--}n+=m[C+A]}}c+=p.length}let h=bp,d=0;if(!s||n>t){let f=s?bp:Hs,u=this._histogram;for(u.fill(0,0,Hs),this._accumulate(e,-1),h=0;h<f;){let m=i+u[h];if(m>t)break;i=m,h++}if(h<f)for(u.fill(0,0,yr),this._accumulate(e,h);d<yr;){let m=i+u[d];if(m>t)break;i=m,d++}}c=0;for(let[,f]of e){let{bandLod:u,span:m}=f.lodTable,_=f.nodeInfos,p=Math.log(f.placement.lodMultiplier)*$n;for(let g=0,T=_.length;g<T;g++){let S=g*m;if(u[S]<0){_[g].optimalLod=-1;continue}let x=o[c+g],C=m-1;for(;C>0;){let E=x-C*p,v=E<0?0:E>=Hs?gf:E|0;if(v>h)break;if(v===h){let A=(E-h)*yr;if((A<0?0:A>=yr?mx:A|0)>=d)break}C--}_[g].optimalLod=u[S+C]}c+=_.length}}_accumulate(e,t){let s=this._position,r=this._histogram,i=t<0||t===0||t===gf,a=0;for(let[,o]of e){let{bandLod:n,bandCount:c,span:h}=o.lodTable,d=o.nodeInfos.length,f=Math.log(o.placement.lodMultiplier)*$n,u=1/f;for(let m=0;m<d;m++){let _=m*h;if(n[_]<0)continue;let p=s[a+m],g=i?1:Math.floor((p-t)*u),T=i?h:Math.min(g+2,h);for(g<1&&(g=1);g<T;g++){let S=c[_+g-1]-c[_+g];if(S===0)continue;let x=p-g*f,C=x<0?0:x>=Hs?gf:x|0;if(t<0)r[C]+=S;else if(C===t){let E=(x-t)*yr;r[E<0?0:E>=yr?mx:E|0]+=S}}}a+=d}}_assignChainEnd(e,t){for(let[,s]of e){let{bandLod:r,span:i}=s.lodTable,a=s.nodeInfos,o=t?0:i-1;for(let n=0,c=a.length;n<c;n++)a[n].optimalLod=r[n*i+o]}}};var gx=new N,Fp=new y,Sx=new y,Op=new J,Np=new J,fo={translationDelta:0,refreshAll:!1},Bp=new Set,Up=new Set,Tf=[],kp=[],Kn=new Set,uo=new Set,Gp=new Set,Tx=[[1,0,0],[0,1,0],[0,0,1],[1,1,0],[1,0,1],[0,1,1],[1,.5,0],[.5,0,1]],ri=null,Ex=1.15,Ef=class{_gsplat;_device;_scene;_workBuffer;_worldStates=new Map;_lastWorldStateVersion=0;_currentVersion=0;_worldStateDirty=!1;_workBufferFormatVersion=-1;_workBufferRebuildRequired=!1;_bufferCopyUploaded=0;_bufferCopyTotal=0;_stateTracker=new _f;_framesTillFullUpdate=0;_lodUpdateRequested=!1;_lastLodCameraPos=new y(1/0,1/0,1/0);_lastLodCameraFwd=new y(1/0,1/0,1/0);_lastLodCameraFov=-1;_budgetBalancer=new Sf;_allocator;_allocationMap=new Map;_lastColorUpdateCameraPos=new y(1/0,1/0,1/0);_colorViewOrtho=null;_colorViewForward=new y;_layerPlacements=[];_layerPlacementsDirty=!1;_placementSetChanged=!1;_octreeInstances=new Map;_octreeInstancesToDestroy=[];_hasNewOctreeInstances=!1;_awaitingLodUpdate=!1;constructor(e,t,s){this._device=e,this._scene=t,this._gsplat=s;let r=s.splatBudget;this._allocator=new of(r>0?Math.ceil(r*Ex):0,Ex),this._workBuffer=new Yn(e,s.format),this._workBufferFormatVersion=this._workBuffer.format.extraStreamsVersion}destroy(){for(let[,e]of this._worldStates){for(let t of e.splats)t.resource.decRefCount();e.destroy()}this._worldStates.clear();for(let[,e]of this._octreeInstances)e.destroy();this._octreeInstances.clear();for(let e of this._octreeInstancesToDestroy)e.destroy();this._octreeInstancesToDestroy.length=0,this._workBuffer.destroy()}get workBuffer(){return this._workBuffer}get currentVersion(){return this._currentVersion}get lastWorldStateVersion(){return this._lastWorldStateVersion}get bufferCopyUploaded(){return this._bufferCopyUploaded}get bufferCopyTotal(){return this._bufferCopyTotal}get awaitingLodUpdate(){return this._awaitingLodUpdate}get hasOctreeInstances(){return this._octreeInstances.size>0}get pendingLoadCount(){let e=0;for(let[,t]of this._octreeInstances)e+=t.pendingLoadCount;return e}get currentState(){return this._worldStates.get(this._currentVersion)}getState(e){return this._worldStates.get(e)}get hasBounds(){return this._workBuffer.frustumCuller.totalBoundsEntries>0}resetFrameStats(){this._bufferCopyUploaded=0,this._bufferCopyTotal=0}invalidate({worldState:e=!1,workBuffer:t=!1}={}){e&&(this._worldStateDirty=!0),t&&(this._workBufferRebuildRequired=!0)}invalidateSortState(){let e=this._worldStates.get(this._currentVersion);return e?(e.sortParametersSet=!1,e.sortedBefore=!1,e.splats):null}syncFormat(e){e.bufferRecreated=!1,e.sortNeeded=!1;let t=this._gsplat.format;this._workBuffer.format!==t&&(this._workBuffer.destroy(),this._workBuffer=new Yn(this._device,t),this._workBufferFormatVersion=this._workBuffer.format.extraStreamsVersion,this._workBufferRebuildRequired=!0,e.bufferRecreated=!0,e.sortNeeded=!0);let s=this._workBuffer.format.extraStreamsVersion;return this._workBufferFormatVersion!==s&&(this._workBufferFormatVersion=s,this._workBuffer.syncWithFormat(),this._workBufferRebuildRequired=!0,e.sortNeeded=!0),e}reconcile(e){uo.clear();for(let t of e)t.resource instanceof mf?(this._octreeInstances.has(t)||(this._octreeInstances.set(t,new hf(this._device,t.resource.octree,t)),this._hasNewOctreeInstances=!0),Gp.add(t)):uo.add(t);for(let[t,s]of this._octreeInstances)Gp.has(t)||(this._octreeInstances.delete(t),this._layerPlacementsDirty=!0,this._placementSetChanged=!0,this._octreeInstancesToDestroy.push(s));if(this._layerPlacementsDirty||(this._layerPlacementsDirty=this._layerPlacements.length!==uo.size),!this._layerPlacementsDirty)for(let t=0;t<this._layerPlacements.length;t++){let s=this._layerPlacements[t];if(!uo.has(s)){this._layerPlacementsDirty=!0;break}}this._placementSetChanged||(this._placementSetChanged=this._layerPlacementsDirty),this._layerPlacements.length=0;for(let t of uo)this._layerPlacements.push(t);uo.clear(),Gp.clear()}update(e,t,s,r){r.newVersion=!1,r.overdrawDirty=!1,r.sortNeeded=!1;for(let[d,f]of this._octreeInstances)(f.octree.destroyed||!d.resource)&&(this._octreeInstances.delete(d),this._layerPlacementsDirty=!0,this._placementSetChanged=!0,this._octreeInstancesToDestroy.push(f));let i=this._layerPlacements;for(let d=i.length-1;d>=0;d--)i[d].resource||(i.splice(d,1),this._layerPlacementsDirty=!0,this._placementSetChanged=!0);--this._framesTillFullUpdate<=0&&(this._framesTillFullUpdate=10,this._lodUpdateRequested=!0);let a=!1;this._lodUpdateRequested&&t&&(a=!0,this._lodUpdateRequested=!1);let o=this._hasNewOctreeInstances&&t;o&&(this._hasNewOctreeInstances=!1);let n=!1,c=!1,h=!1;if(a){for(let[,f]of this._octreeInstances){let u=f.update();this._layerPlacementsDirty||(this._layerPlacementsDirty=u),this._placementSetChanged||(this._placementSetChanged=f.consumePlacementSetChanged());let m=f.consumeNeedsLodUpdate();n||(n=m)}let d=this._gsplat.lodUpdateDistance;for(let[,f]of this._octreeInstances){let u=f.testMoved(d);c||(c=u)}h=this.testCameraMovedForLod(e),this._awaitingLodUpdate=!1}if(this._gsplat.dirty&&(this._layerPlacementsDirty=!0,r.overdrawDirty=!0,this._workBufferRebuildRequired=!0,r.sortNeeded=!0,this._octreeInstances.size>0&&(this._awaitingLodUpdate=!0)),h||c||this._gsplat.dirty||n||o){for(let[,f]of this._octreeInstances)f.updateMoved();this._lastLodCameraPos.copy(e.getPosition()),this._lastLodCameraFwd.copy(e.forward),this._lastLodCameraFov=e.camera.fov;let d=this._gsplat.splatBudget;this._enforceBudget(d>0?d:1/0,e)}return this._updateWorldState(s)&&(r.newVersion=!0,r.sortNeeded=!0),r}_updateWorldState(e){let t=this._stateTracker.hasChanges(this._layerPlacements);for(let[,o]of this._octreeInstances)this._stateTracker.hasChanges(o.activePlacements)&&(t=!0);if(!(this._layerPlacementsDirty||t||this._worldStates.size===0||this._worldStateDirty))return!1;this._lastWorldStateVersion++;let i=[];for(let o of this._layerPlacements){if(e&&!o.resource.hasCenters)continue;o.ensureInstanceStreams(this._device);let n=new Wn(this._device,o.resource,o);i.push(n)}for(let[,o]of this._octreeInstances)o.activePlacements.forEach(n=>{if(n.resource){let c=n.resource;if(e&&!c.hasCenters)return;n.ensureInstanceStreams(this._device);let h=n.intervals.size>0?o.octree.nodes:null,d=h?o.nodeInfos:null,f=new Wn(this._device,n.resource,n,h,d);i.push(f)}});let a=new pf(this._device,this._lastWorldStateVersion,i,this._allocator,this._allocationMap);for(let o of a.splats)o.resource.incRefCount();for(let[,o]of this._octreeInstances)if(o.removedCandidates&&o.removedCandidates.size){for(let n of o.removedCandidates)a.pendingReleases.push([o.octree,n]);o.removedCandidates.clear()}if(this._octreeInstancesToDestroy.length){for(let o of this._octreeInstancesToDestroy){if(o.removedCandidates&&o.removedCandidates.size){for(let c of o.removedCandidates)a.pendingReleases.push([o.octree,c]);o.removedCandidates.clear()}let n=o.getFileDecrements();for(let c of n)a.pendingReleases.push([o.octree,c]);o.destroy(!0)}this._octreeInstancesToDestroy.length=0}return this._placementSetChanged&&(a.fullRebuild=!0),this._worldStates.set(this._lastWorldStateVersion,a),this._layerPlacementsDirty=!1,this._placementSetChanged=!1,this._worldStateDirty=!1,!0}markSorted(e,t,s,r,i){i.rebuilt=!1,i.count=0,i.textureSize=0,this.cleanupOldWorldStates(e),this._currentVersion=e;let a=this._worldStates.get(e);return a&&!a.sortedBefore&&(a.sortedBefore=!0,this.rebuildWorkBuffer(a,t,!1,s,r),i.rebuilt=!0,i.count=t,i.textureSize=a.textureSize),i}onSorted(e,t,s,r,i,a){return this.markSorted(e,t,r,i,a),this._worldStates.get(e)&&this._workBuffer.setOrderData(s),a}bake(e,t,s,r){r.rebuilt=!1,r.count=0,r.textureSize=0,r.sortNeeded=!1;let i=this._worldStates.get(e);if(i?.sortedBefore){if(this._workBufferRebuildRequired){let a=i.totalActiveSplats;this.rebuildWorkBuffer(i,a,!0,t,s),this._workBufferRebuildRequired=!1,r.rebuilt=!0,r.count=a,r.textureSize=i.textureSize}else r.sortNeeded=this.applyWorkBufferUpdates(i,t);this.updateColorCameraTracking(t)}return r}rebuildWorkBuffer(e,t,s,r,i){let a=e.textureSize;a!==this._workBuffer.textureSize&&this._workBuffer.resize(a),i&&(this._workBuffer.frustumCuller.updateBoundsData(e.boundsGroups),this._workBuffer.frustumCuller.updateTransformsData(e.boundsGroups));let o=s||e.fullRebuild,n=o?e.splats:e.needsUpload,c=o?null:e.needsUploadIds;if(n.length>0){let h=this._allocationMap.size,d=o?h:e.needsUploadIds.size;this._bufferCopyUploaded+=d,this._bufferCopyTotal=h,this._workBuffer.render(n,r,this.getDebugColors(),c)}o&&this._recordColorView(r);for(let h=0;h<e.splats.length;h++)e.splats[h].update();if(this.updateColorCameraTracking(r),e.pendingReleases&&e.pendingReleases.length){let h=this._gsplat.cooldownTicks;for(let[d,f]of e.pendingReleases)d.decRefCount(f,h);e.pendingReleases.length=0}}cleanupOldWorldStates(e){let t=this._worldStates.get(e);if(!t.fullRebuild){for(let s=this._currentVersion+1;s<e;s++)if(this._worldStates.get(s)?.fullRebuild){t.fullRebuild=!0;break}}if(!t.fullRebuild){let s=t.needsUploadIds,r=t.allocIdToSplat;for(let i=this._currentVersion+1;i<e;i++){let a=this._worldStates.get(i);if(a){for(let o of a.needsUploadIds)if(!s.has(o)){s.add(o);let n=r.get(o);n&&!Up.has(n)&&(t.needsUpload.push(n),Up.add(n))}}}Up.clear()}for(let s=this._currentVersion;s<e;s++){let r=this._worldStates.get(s);if(r){for(let i of r.splats)i.resource.decRefCount();this._worldStates.delete(s),r.destroy()}}}applyWorkBufferUpdates(e,t){let{colorUpdateAngle:s}=this._gsplat,r=Math.tan(s*O.DEG_TO_RAD),i=t.getPosition(),{translationDelta:a,refreshAll:o}=this.calculateColorCameraDeltas(t),n=a>0||o,c=!1,h=0;return e.splats.forEach(d=>{if(d.update()){if(Tf.push(d),h+=d.intervalAllocIds.length,d.nodeInfos)for(let f of d.intervalNodeIndices)d.nodeInfos[f].colorAccumulatedTranslation=0;else d.colorAccumulatedTranslation=0;c=!0}else if(n&&d.hasSphericalHarmonics)if(kp.push(d),d.nodeInfos){let f=d.intervalNodeIndices,u=r*r;for(let m=0;m<f.length;m++){let _=d.nodeInfos[f[m]],p=_.colorAccumulatedTranslation+a;_.colorAccumulatedTranslation=p,(o||p*p>=u*Math.max(1,_.worldDistanceSq))&&(Kn.add(d.intervalAllocIds[m]),_.colorAccumulatedTranslation=0,h++)}}else{d.colorAccumulatedTranslation+=a,gx.copy(d.node.getWorldTransform()).invert(),gx.transformPoint(i,Fp),d.aabb.closestPoint(Fp,Sx);let f=Fp.distance(Sx)*d.node.getWorldTransform().getScale().x,u=r*Math.max(1,f);(o||d.colorAccumulatedTranslation>=u)&&(Kn.add(d.allocId),h+=d.intervalAllocIds.length,d.colorAccumulatedTranslation=0)}}),this._bufferCopyUploaded+=h,this._bufferCopyTotal=this._allocationMap.size,Tf.length>0&&(this._workBuffer.render(Tf,t,this.getDebugColors()),Tf.length=0),Kn.size>0&&(this._workBuffer.renderColor(kp,t,this.getDebugColors(),Kn),Kn.clear()),kp.length=0,o&&this._recordColorView(t),c}testCameraMovedForLod(e){let t=this._gsplat.lodUpdateDistance,s=e.getPosition(),r=this._lastLodCameraPos.distance(s)>t;if(r)return!0;let i=!1,a=this._gsplat.lodUpdateAngle;if(a>0&&this._gsplat.lodBehindPenalty>1)if(Number.isFinite(this._lastLodCameraFwd.x)){let c=e.forward,h=Math.min(1,Math.max(-1,this._lastLodCameraFwd.dot(c))),d=Math.acos(h),f=a*O.DEG_TO_RAD;i=d>f}else i=!0;let o=e.camera.fov,n=this._lastLodCameraFov<0||Math.abs(o-this._lastLodCameraFov)>this._lastLodCameraFov*.02;return r||i||n}updateColorCameraTracking(e){this._lastColorUpdateCameraPos.copy(e.getPosition())}_recordColorView(e){this._colorViewOrtho=e.camera.projection===Bt,this._colorViewForward.copy(e.forward)}getDebugColors(){let e=this._gsplat.debug;if(e===hn){ri??(ri=[]);let t=Math.random(),s=Math.random(),r=Math.random();for(let i=0;i<Tx.length;i++)ri[i]??(ri[i]=[0,0,0]),ri[i][0]=t,ri[i][1]=s,ri[i][2]=r;return ri}else if(e===Pi)return Tx}calculateColorCameraDeltas(e){fo.translationDelta=0,fo.refreshAll=!1;let t=e.camera.projection===Bt;if(t!==this._colorViewOrtho)fo.refreshAll=!0;else if(t){let s=e.forward;if(!this._colorViewForward.equals(s)){let r=O.clamp(this._colorViewForward.dot(s),-1,1);fo.refreshAll=Math.acos(r)*O.RAD_TO_DEG>=this._gsplat.colorUpdateAngle}}else if(isFinite(this._lastColorUpdateCameraPos.x)){let s=e.getPosition();fo.translationDelta=this._lastColorUpdateCameraPos.distance(s)}return fo}_enforceBudget(e,t){let s=this._workBuffer.textureSize,r=0,i=0;for(let n of this._layerPlacements){let c=n.resource;if(c){let h=c.numSplats??0;r+=h,i+=(s-h%s)%s}}let a=Math.max(1,e-r);for(let[,n]of this._octreeInstances){n.resolveLodRange(),n.evaluateNodeDistances(t,this._gsplat);for(let c of n.activePlacements){let d=c.resource?.numSplats??0;i+=(s-d%s)%s}}let o=Math.max(1,a-i);this._budgetBalancer.balance(this._octreeInstances,o,this._gsplat.splatBudgetMode===sh);for(let[,n]of this._octreeInstances)n.applyLodChanges(this._gsplat);for(let[,n]of this._octreeInstances){let c=n.octree;Bp.has(c)||(Bp.add(c),c.flushRequests())}Bp.clear()}computeAggregateAabb(){let e=!1,t=this._layerPlacements;for(let s=0;s<t.length;s++)e=this._accumulatePlacementAabb(t[s],e);for(let[,s]of this._octreeInstances)e=this._accumulatePlacementAabb(s.placement,e);return e?Op:null}_accumulatePlacementAabb(e,t){let s=e.aabb;return s?(Np.setFromTransformedAabb(s,e.node.getWorldTransform()),t?Op.add(Np):Op.copy(Np),!0):t}tickCooldowns(e){let t=this._gsplat.cooldownTicks;for(let[,s]of this._octreeInstances)s.octree.updateCooldownTick(t,e)}markInstancesNeedLodUpdate(){for(let[,e]of this._octreeInstances)e.needsLodUpdate=!0}prepareSortParameters(e){return{command:"intervals",textureSize:e.textureSize,totalActiveSplats:e.totalActiveSplats,version:e.version,ids:e.splats.map(t=>t.resource.id),pixelOffsets:e.splats.map(t=>t.intervalOffsets),intervals:e.splats.map(t=>t.intervals)}}};var mo=class{device;node;cameraNode;layer;workBuffer;renderMode;_workBufferFormatVersion=-1;fisheyeProj=new qa;constructor(e,t,s,r,i){this.device=e,this.node=t,this.cameraNode=s,this.layer=r,this.workBuffer=i,this._workBufferFormatVersion=i?.format.extraStreamsVersion??-1}destroy(){}resolveFisheye(e){return!!this.cameraNode.camera?.camera?.xrActive&&e>0?0:e}setRenderMode(e){this.renderMode=e}get usesGpuSort(){return!1}get requiresBounds(){return!1}get requiresCpuSort(){return!this.usesGpuSort}get material(){return null}setDataSource(e){this.workBuffer=e,this.onWorkBufferFormatChanged()}onWorkBufferFormatChanged(){}update(e,t){}setGpuSortedRendering(e,t,s,r){}setCpuSortedRendering(){}setOrderData(){}frameUpdate(e){}updateOverdrawMode(e){}invalidateCullUpload(){}prepareRenderView(e,t,s){return!1}preparePickingView(e,t,s){return null}};var yf=class extends mo{_material;meshInstance;originalBlendType=ir;_internalDefines=new Set;_lastFisheyeEnabled=!1;_lastSourceChunksKey="";_sourceMaterialVersion=-1;constructor(e,t,s,r,i){super(e,t,s,r,i),this._material=new st({uniqueName:"UnifiedSplatMaterial",vertexGLSL:'#include "gsplatVS"',fragmentGLSL:'#include "gsplatPS"',vertexWGSL:'#include "gsplatVS"',fragmentWGSL:'#include "gsplatPS"',attributes:{vertex_position:le}}),this._material.setDefine("{GSPLAT_INSTANCE_SIZE}",Ce.instanceSize),this.configureMaterial(),this._material.defines.forEach((a,o)=>{this._internalDefines.add(o)}),this._internalDefines.add("{GSPLAT_INSTANCE_SIZE}"),this._internalDefines.add("GSPLAT_UNIFIED_ID"),this._internalDefines.add("PICK_CUSTOM_ID"),this._internalDefines.add("GSPLAT_INDIRECT_DRAW"),this._internalDefines.add("GSPLAT_SEPARATE_OPACITY"),this._internalDefines.add("GSPLAT_FISHEYE"),this._internalDefines.add("GSPLAT_NO_FOG"),this._internalDefines.add("GSPLAT_NO_TONEMAP"),this._internalDefines.add("GSPLAT_OVERDRAW"),this.meshInstance=this.createMeshInstance()}setRenderMode(e){let t=this.renderMode??0,s=(t&Et)!==0,r=(t&Ms)!==0,i=(e&Et)!==0,a=(e&Ms)!==0;this.meshInstance.castShadow=a,s&&!i&&this.layer.removeMeshInstances([this.meshInstance],!0),r&&!a&&this.layer.removeShadowCasters([this.meshInstance]),!s&&i&&this.layer.addMeshInstances([this.meshInstance],!0),!r&&a&&this.layer.addShadowCasters([this.meshInstance]),super.setRenderMode(e)}destroy(){this.renderMode&&(this.renderMode&Et&&this.layer.removeMeshInstances([this.meshInstance],!0),this.renderMode&Ms&&this.layer.removeShadowCasters([this.meshInstance])),this._material.destroy(),this.meshInstance.destroy(),super.destroy()}get material(){return this._material}onWorkBufferFormatChanged(){this.configureMaterial()}configureMaterial(){let{workBuffer:e}=this;this._injectFormatChunks(),this._material.setDefine("SH_BANDS","0"),this._material.setDefine("GSPLAT_SEPARATE_OPACITY","");let t=e.format.getStream("dataColor");t&&t.format!==_t&&this._material.setDefine("GSPLAT_COLOR_FLOAT",""),this._updateIdDefines(),this._bindWorkBufferTextures();let s=!1;this._material.setParameter("numSplats",0),this.setOrderData(),this._material.setDefine(`DITHER_${s?"BLUENOISE":"NONE"}`,""),this._material.cull=0,this._material.blendType=s?tt:fs,this._material.depthWrite=!!s,this._material.update()}_bindWorkBufferTextures(){let{workBuffer:e}=this;for(let t of e.format.resourceStreams){let s=e.getTexture(t.name);s&&this._material.setParameter(t.name,s)}}_injectFormatChunks(){let e=this.device.isWebGPU?this._material.shaderChunks.wgsl:this._material.shaderChunks.glsl,t=this.workBuffer.format;e.set("gsplatDeclarationsVS",t.getInputDeclarations()),e.set("gsplatReadVS",t.getReadCode())}update(e,t){this.meshInstance.instancingCount=Math.ceil(e/Ce.instanceSize),this._material.setParameter("numSplats",e),this._material.setParameter("splatTextureSize",t),this.meshInstance.visible=e>0}setGpuSortedRendering(e,t,s,r){this.meshInstance.setIndirect(null,e,1),this._material.setParameter("compactedSplatIds",t),this._material.setParameter("numSplatsStorage",s),this._material.getDefine("GSPLAT_INDIRECT_DRAW")||(this._material.setDefine("GSPLAT_INDIRECT_DRAW",!0),this._material.update()),this._material.setParameter("splatTextureSize",r),this.meshInstance.visible=!0,this.meshInstance.instancingCount<=0&&(this.meshInstance.instancingCount=1)}setCpuSortedRendering(){this.meshInstance.setIndirect(null,-1),this._material.getDefine("GSPLAT_INDIRECT_DRAW")&&(this._material.setDefine("GSPLAT_INDIRECT_DRAW",!1),this._material.update()),this.setOrderData(),this.meshInstance.visible=!1}setOrderData(){this.device.isWebGPU?this._material.setParameter("splatOrder",this.workBuffer.orderBuffer):this._material.setParameter("splatOrder",this.workBuffer.orderTexture)}frameUpdate(e){this._material.sceneTexturesWrite=e.sceneDepthWrite,e.colorRamp&&this._material.setParameter("colorRampIntensity",e.colorRampIntensity);let t=this.cameraNode.camera;this.fisheyeProj.update(this.resolveFisheye(e.fisheye),t.fov,t.projectionMatrix);let s=this.fisheyeProj.enabled;if(s!==this._lastFisheyeEnabled&&(this._lastFisheyeEnabled=s,this._material.setDefine("GSPLAT_FISHEYE",s),this._material.update()),s){let o=this.fisheyeProj;this._material.setParameter("fisheye_k",o.k),this._material.setParameter("fisheye_inv_k",o.invK),this._material.setParameter("fisheye_projMat00",o.projMat00),this._material.setParameter("fisheye_projMat11",o.projMat11)}let r=!e.useFog,i=!e.useTonemap;(r!==this._lastNoFog||i!==this._lastNoTonemap)&&(this._lastNoFog=r,this._lastNoTonemap=i,this._material.setDefine("GSPLAT_NO_FOG",r),this._material.setDefine("GSPLAT_NO_TONEMAP",i),this._material.update()),this._syncWithWorkBufferFormat();let a=e.material.updateVersion;this._sourceMaterialVersion!==a&&(this.copyMaterialSettings(e.material),this._sourceMaterialVersion=a)}_updateIdDefines(){let e=!!this.workBuffer.format.getStream("pcId");this._material.setDefine("GSPLAT_UNIFIED_ID",e),this._material.setDefine("PICK_CUSTOM_ID",e)}_syncWithWorkBufferFormat(){let e=this.workBuffer.format;this._workBufferFormatVersion!==e.extraStreamsVersion&&(this._workBufferFormatVersion=e.extraStreamsVersion,this.workBuffer.syncWithFormat(),this._injectFormatChunks(),this._bindWorkBufferTextures(),this._updateIdDefines(),this._material.update())}copyMaterialSettings(e){let t=[];this._material.defines.forEach((r,i)=>{!this._internalDefines.has(i)&&!e.defines.has(i)&&t.push(i)}),t.forEach(r=>this._material.setDefine(r,void 0)),e.defines.forEach((r,i)=>{this._material.setDefine(i,r)});let s=e.parameters;for(let r in s)s.hasOwnProperty(r)&&this._material.setParameter(r,s[r].data);if(e.hasShaderChunks){let r=e.shaderChunks.key;r!==this._lastSourceChunksKey&&(this._material.shaderChunks.copy(e.shaderChunks),this._injectFormatChunks(),this._lastSourceChunksKey=r)}this._material.update()}updateOverdrawMode(e){let t=!!e.colorRamp,s=this._material.getDefine("GSPLAT_OVERDRAW");t&&(this._material.setParameter("colorRamp",e.colorRamp),this._material.setParameter("colorRampIntensity",e.colorRampIntensity)),t!==s&&(this._material.setDefine("GSPLAT_OVERDRAW",t),t?(this.originalBlendType=this._material.blendType,this._material.blendType=ir):this._material.blendType=this.originalBlendType,this._material.update())}createMeshInstance(){let e=Ce.createMesh(this.device),t=new nt(e,this._material);t.node=this.node,t.setInstancing(!0,!0),t.instancingCount=0;let s=this.cameraNode.camera;return t.isVisibleFunc=r=>{let i=this.renderMode??0;return s.camera===r&&i&Et?!0:i&Ms?r.node?.name===Na:!1},t}};var QD=6*Ce.instanceSize,JD=256,eI=new Set(["{CACHE_STRIDE}","RADIAL_SORT","PICK_MODE","GSPLAT_FISHEYE","GSPLAT_AA","GSPLAT_COLOR_FLOAT","GSPLAT_XR"]),tI=new y,Vp=new k,yx=new N,zp=new Float32Array(16),Cx=new Float32Array(16),Hp=new Float32Array(16),Wp=new N,Cf=class{device;projCache=null;sortKeys=null;renderCounter=null;binWeightsBuffer=null;binWeightsUtil;_projectorComputes=new Map;_projectorBindGroupFormat=null;_projectorUniformBufferFormat=null;_projectorUniformBufferFormatFisheye=null;_projectorUniformBufferFormatStereo=null;_writeIndirectArgsCompute=null;_writeArgsBindGroupFormat=null;_writeArgsUniformBufferFormat=null;_formatVersion=-1;_materialKey="";_userModifySource=null;_userVaryingsSource=null;_userCacheWriteSource=null;_userDefines=null;_userCacheWords=0;_allocatedCacheCount=0;_allocatedCacheStride=0;cameraPositionData=new Float32Array(3);cameraDirectionData=new Float32Array(3);constructor(e){this.device=e,this.binWeightsUtil=new Tr,this.binWeightsBuffer=new re(e,Tr.NUM_BINS*2*4,12),this.renderCounter=new re(e,4,12),this._createUniformBufferFormats(),this._createWriteIndirectArgsCompute()}destroy(){this.projCache?.destroy(),this.sortKeys?.destroy(),this.renderCounter?.destroy(),this.binWeightsBuffer?.destroy();for(let e of this._projectorComputes.values())e.destroy(),e.shader?.destroy();this._projectorComputes.clear(),this._projectorBindGroupFormat?.destroy(),this._writeIndirectArgsCompute?.destroy(),this._writeIndirectArgsCompute?.shader?.destroy(),this._writeArgsBindGroupFormat?.destroy(),this.projCache=null,this.sortKeys=null,this.renderCounter=null,this.binWeightsBuffer=null,this._projectorBindGroupFormat=null,this._projectorUniformBufferFormat=null,this._projectorUniformBufferFormatFisheye=null,this._projectorUniformBufferFormatStereo=null,this._writeIndirectArgsCompute=null,this._writeArgsBindGroupFormat=null,this._writeArgsUniformBufferFormat=null}_createUniformBufferFormats(){let e=this.device,t=[new I("splatTextureSize",X),new I("numBins",X),new I("isOrtho",X),new I("stochastic",X),new I("viewProj",Be),new I("viewMatrix",Be),new I("cameraPosition",Z),new I("minPixelSize",b),new I("cameraDirection",Z),new I("focal",b),new I("focalY",b),new I("viewportWidth",b),new I("viewportHeight",b),new I("nearClip",b),new I("farClip",b),new I("alphaClip",b),new I("minContribution",b),new I("minDist",b),new I("invRange",b),new I("foveationStrength",b),new I("foveationCenter",b)];this._projectorUniformBufferFormat=new Te(e,t),this._projectorUniformBufferFormatFisheye=new Te(e,[...t.map(s=>new I(s.name,s.type)),new I("fisheye_k",b),new I("fisheye_inv_k",b),new I("fisheye_projMat00",b),new I("fisheye_projMat11",b)]),this._projectorUniformBufferFormatStereo=new Te(e,[...t.map(s=>new I(s.name,s.type)),new I("viewProj1",Be)]),this._writeArgsUniformBufferFormat=new Te(e,[new I("drawSlot",X),new I("indexCount",X),new I("sortSlotBase",X),new I("pad0",X),new I("sortIndirectInfo",Pt)])}_createWriteIndirectArgsCompute(){let e=this.device;this._writeArgsBindGroupFormat=new Ae(e,[new V("renderCounter",B,!0),new V("indirectDrawArgs",B,!1),new V("numSplatsBuf",B,!1),new V("indirectDispatchArgs",B,!1),new V("sortElementCountBuf",B,!1),new De("uniforms",B)]);let t=new Map([["{INSTANCE_SIZE}",Ce.instanceSize.toString()]]),s=new be(e,{name:"GSplatProjectorWriteIndirectArgs",shaderLanguage:q,cshader:"",cdefines:t,computeBindGroupFormat:this._writeArgsBindGroupFormat,computeUniformBufferFormats:{uniforms:this._writeArgsUniformBufferFormat}});this._writeIndirectArgsCompute=new Ie(e,s,"GSplatProjectorWriteIndirectArgs")}_destroyProjectorComputes(){for(let e of this._projectorComputes.values())e.destroy(),e.shader?.destroy();this._projectorComputes.clear(),this._projectorBindGroupFormat?.destroy(),this._projectorBindGroupFormat=null}_projectorKey(e,t,s,r,i){return`${e?"r":"l"}${t?"p":""}${s?"f":""}${r?"a":""}${i?"s":""}`}_createProjectorCompute(e,t,s,r,i,a){let o=this.device,n=e.format,c=[new V("compactedSplatIds",B,!0),new V("sortElementCount",B,!0),new V("projCache",B),new V("sortKeys",B),new V("renderCounter",B),new V("binWeights",B,!0),new De("uniforms",B)];this._projectorBindGroupFormat||(this._projectorBindGroupFormat=new Ae(o,[...c,...n.getComputeBindFormats()]));let h=new Map;h.set("gsplatCommonCS",""),h.set("gsplatComputeSplatCS",""),h.set("gsplatFormatDeclCS",n.getComputeInputDeclarations(c.length)),h.set("gsplatFormatReadCS",n.getReadCode()),h.set("gsplatHelpersVS",""),h.set("gsplatModifyVS",this._userModifySource??""),h.set("gsplatUserVaryingsCS",this._userVaryingsSource??""),h.set("gsplatUserCacheWriteCS",this._userCacheWriteSource??""),h.set("gsplatProjectCommonCS","");let d=new Map;d.set("{CACHE_STRIDE}",(8+this._userCacheWords).toString()),t&&d.set("RADIAL_SORT",""),s&&d.set("PICK_MODE",""),r&&d.set("GSPLAT_FISHEYE",""),i&&d.set("GSPLAT_AA",""),a&&d.set("GSPLAT_XR","");let f=n.getStream("dataColor");f&&f.format!==_t&&d.set("GSPLAT_COLOR_FLOAT",""),this._userDefines&&this._userDefines.forEach((p,g)=>{eI.has(g)||d.set(g,p)});let u=`GSplatProjector${t?"Radial":"Linear"}${s?"Pick":""}${r?"Fisheye":""}${i?"Aa":""}${a?"Stereo":""}`,m=a?this._projectorUniformBufferFormatStereo:r?this._projectorUniformBufferFormatFisheye:this._projectorUniformBufferFormat,_=new be(o,{name:u,shaderLanguage:q,cshader:"",cincludes:h,cdefines:d,computeBindGroupFormat:this._projectorBindGroupFormat,computeUniformBufferFormats:{uniforms:m}});return new Ie(o,_,u)}_getProjectorCompute(e,t,s=!1,r=!1,i=!1,a=!1){let o=e.format;this._formatVersion!==o.extraStreamsVersion&&(this._destroyProjectorComputes(),this._formatVersion=o.extraStreamsVersion);let n=this._projectorKey(t,s,r,i,a),c=this._projectorComputes.get(n);return c||(c=this._createProjectorCompute(e,t,s,r,i,a),this._projectorComputes.set(n,c)),c}_updateMaterial(e,t=0){let s=e?.shaderChunks?.key??"",r=e?.definesKey??"",i=`${s}|${r}|${t}`;if(i!==this._materialKey){this._materialKey=i,this._userDefines=e?.defines??null,this._userCacheWords=t;let a=e?.getShaderChunks?.(q);this._userModifySource=a?.get("gsplatModifyVS")??null,this._userVaryingsSource=a?.get("gsplatUserVaryingsCS")??null,this._userCacheWriteSource=a?.get("gsplatUserCacheWriteCS")??null,this._destroyProjectorComputes()}}_ensureCapacity(e){let t=8+this._userCacheWords;(e>this._allocatedCacheCount||t!==this._allocatedCacheStride)&&(this.projCache?.destroy(),this.sortKeys?.destroy(),this._allocatedCacheCount=e,this._allocatedCacheStride=t,this.projCache=new re(this.device,e*t*4),this.sortKeys=new re(this.device,e*4,4))}dispatch(e){let{workBuffer:t,cameraNode:s,compactedSplatIds:r,sortElementCountBuffer:i,totalCapacity:a,radialSort:o,numBits:n,minDist:c,maxDist:h,alphaClip:d,minPixelSize:f,minContribution:u,foveationStrength:m=0,foveationCenter:_=.3,viewportWidth:p,viewportHeight:g,pickMode:T=!1,stochastic:S=!1,fisheyeProj:x,antiAlias:C=!1,isStereo:E=!1,material:v,userCacheWords:A=0}=e,D=!!x?.enabled,R=!!E&&!T&&!D,w=o&&!S,M=C&&!T;this._updateMaterial(v,A),this._ensureCapacity(a),this.renderCounter.clear();let P=this._getProjectorCompute(t,w,T,D,M,R);if(v){let he=v.parameters;for(let j in he)he.hasOwnProperty(j)&&P.setParameter(j,he[j].data)}let L=s.getPosition(),U=s.getWorldTransform().getZ(tI).normalize(),F=h-c,Y=F>0?1/F:1;if(!S){let he=1<<n,j=Tr.computeCameraBin(w,c,F),He=this.binWeightsUtil.compute(j,he);this.binWeightsBuffer.write(0,He)}P.setParameter("compactedSplatIds",r),P.setParameter("sortElementCount",i),P.setParameter("projCache",this.projCache),P.setParameter("sortKeys",this.sortKeys),P.setParameter("renderCounter",this.renderCounter),P.setParameter("binWeights",this.binWeightsBuffer);for(let he of t.format.resourceStreams){let j=t.getTexture(he.name);j&&P.setParameter(he.name,j)}let W=s.camera.camera,ae=this.device.isWebGPU,H,ee;if(R){let he=W.xrViews;W.updateViewTransforms(),zp.set(he[0].projViewOffMat.data),Cx.set(he[1].projViewOffMat.data),Hp.set(he[0].viewOffMat.data),H=p*Math.abs(he[0].projMat.data[0]),ee=g*Math.abs(he[0].projMat.data[5])}else{let he=W.viewMatrix;yx.mul2(Vt.applyShaderProjectionTransform(W.projectionMatrix,Wp,!1,ae),he),zp.set(yx.data),Hp.set(he.data),H=p*Math.abs(Wp.data[0]),ee=g*Math.abs(Wp.data[5])}this.cameraPositionData[0]=L.x,this.cameraPositionData[1]=L.y,this.cameraPositionData[2]=L.z,P.setParameter("cameraPosition",this.cameraPositionData),this.cameraDirectionData[0]=U.x,this.cameraDirectionData[1]=U.y,this.cameraDirectionData[2]=U.z,P.setParameter("cameraDirection",this.cameraDirectionData),P.setParameter("viewMatrix",Hp),P.setParameter("viewProj",zp),R&&P.setParameter("viewProj1",Cx),P.setParameter("focal",H),P.setParameter("focalY",ee),P.setParameter("viewportWidth",p),P.setParameter("viewportHeight",g),P.setParameter("nearClip",W.nearClip),P.setParameter("farClip",W.farClip),P.setParameter("alphaClip",d),P.setParameter("minPixelSize",f),P.setParameter("minContribution",u),P.setParameter("foveationStrength",m),P.setParameter("foveationCenter",_),P.setParameter("isOrtho",W.projection===Bt?1:0),P.setParameter("splatTextureSize",t.textureSize),P.setParameter("numBins",Tr.NUM_BINS),P.setParameter("minDist",c),P.setParameter("invRange",Y),P.setParameter("stochastic",S?1:0),D&&(P.setParameter("fisheye_k",x.k),P.setParameter("fisheye_inv_k",x.invK),P.setParameter("fisheye_projMat00",x.projMat00),P.setParameter("fisheye_projMat11",x.projMat11));let Ze=Math.ceil(a/JD);Ie.calcDispatchSize(Ze,Vp,this.device.limits.maxComputeWorkgroupsPerDimension||65535),P.setupDispatch(Vp.x,Vp.y,1),this.device.computeDispatch([P],"GSplatProjector")}writeIndirectArgs(e,t,s,r,i){let a=this._writeIndirectArgsCompute;a.setParameter("renderCounter",this.renderCounter),a.setParameter("indirectDrawArgs",this.device.indirectDrawBuffer),a.setParameter("numSplatsBuf",s),a.setParameter("indirectDispatchArgs",this.device.indirectDispatchBuffer),a.setParameter("sortElementCountBuf",r),a.setParameter("drawSlot",e),a.setParameter("indexCount",QD),a.setParameter("sortSlotBase",t),a.setParameter("pad0",0),a.setParameter("sortIndirectInfo",i),a.setupDispatch(1),this.device.computeDispatch([a],"GSplatProjectorWriteIndirectArgs")}};function Ax(l){let e=l.splats,t=l.totalIntervals,s=new Uint32Array(t*4),r=0;for(let i=0;i<e.length;i++){let a=e[i];if(a.intervals.length>0){let o=a.intervalNodeIndices;for(let n=0;n<a.intervals.length;n+=2){let c=a.intervals[n+1]-a.intervals[n];s[r++]=a.intervalOffsets[n/2],s[r++]=c,s[r++]=a.boundsBaseIndex+(o.length>0?o[n/2]:0),s[r++]=0}}else s[r++]=a.intervalOffsets[0],s[r++]=a.activeSplats,s[r++]=a.boundsBaseIndex,s[r++]=0}return s}var Xp=256,sI=6*Ce.instanceSize,po=class{device;_scratch;compactedSplatIds=null;intervalsBuffer=null;countBuffer=null;prefixSumKernel=null;numSplatsBuffer=null;sortElementCountBuffer=null;allocatedIntervalCount=0;allocatedCountBufferSize=0;_uploadedVersion=-1;_cullComputePerspective=null;_cullComputeFisheye=null;_scatterCompute=null;_scatterDispatchSize=new k(1,1);_writeIndirectArgsCompute=null;_cullBindGroupFormatPerspective=null;_cullBindGroupFormatFisheye=null;_scatterBindGroupFormat=null;_writeArgsBindGroupFormat=null;_scatterUniformBufferFormat=null;_writeArgsUniformBufferFormat=null;constructor(e,t){this.device=e,this._scratch=t,this.numSplatsBuffer=new re(e,4,12),this.sortElementCountBuffer=new re(e,4,12),this.prefixSumKernel=new Za(e),this._createUniformBufferFormats(),this._createScatterCompute(),this._createWriteIndirectArgsCompute()}destroy(){this.intervalsBuffer?.destroy(),this.countBuffer?.destroy(),this.prefixSumKernel?.destroy(),this.numSplatsBuffer?.destroy(),this.sortElementCountBuffer?.destroy(),this._destroyCullPass(),this._scatterCompute?.destroy(),this._scatterCompute?.shader?.destroy(),this._scatterBindGroupFormat?.destroy(),this._writeIndirectArgsCompute?.destroy(),this._writeIndirectArgsCompute?.shader?.destroy(),this._writeArgsBindGroupFormat?.destroy(),this.compactedSplatIds=null,this.intervalsBuffer=null,this.countBuffer=null,this.prefixSumKernel=null,this.numSplatsBuffer=null,this.sortElementCountBuffer=null,this._scatterCompute=null,this._scatterBindGroupFormat=null,this._writeIndirectArgsCompute=null,this._writeArgsBindGroupFormat=null,this._scatterUniformBufferFormat=null,this._writeArgsUniformBufferFormat=null}_destroyCullPass(){this._cullComputePerspective?.destroy(),this._cullComputePerspective?.shader?.destroy(),this._cullBindGroupFormatPerspective?.destroy(),this._cullComputePerspective=null,this._cullBindGroupFormatPerspective=null,this._cullComputeFisheye?.destroy(),this._cullComputeFisheye?.shader?.destroy(),this._cullBindGroupFormatFisheye?.destroy(),this._cullComputeFisheye=null,this._cullBindGroupFormatFisheye=null}_createUniformBufferFormats(){let e=this.device;this._scatterUniformBufferFormat=new Te(e,[new I("numIntervals",X),new I("pad0",X),new I("pad1",X),new I("pad2",X)]),this._writeArgsUniformBufferFormat=new Te(e,[new I("drawSlot",X),new I("indexCount",X),new I("dispatchSlotBase",X),new I("totalSplats",X),new I("sortIndirectInfo",Pt)])}_createCullPass(e){let t=this.device,s=e?"Fisheye":"",r=new Ae(t,[new De("uniforms",B),new V("intervals",B,!0),new V("countBuffer",B,!1),new V("boundsBuffer",B,!0),new V("transformsBuffer",B,!0)]),i=new Map([["{WORKGROUP_SIZE}",Xp.toString()]]);e&&i.set("GSPLAT_FISHEYE","");let a=e?new Te(t,[new I("cameraWorldPos",Z),new I("maxTheta",b),new I("cameraForward",Z),new I("numIntervals",X)]):new Te(t,[new I("frustumPlanes",Pe,6),new I("numIntervals",X)]),o=new be(t,{name:`GSplatIntervalCull${s}`,shaderLanguage:q,cshader:"",cdefines:i,computeBindGroupFormat:r,computeUniformBufferFormats:{uniforms:a}});return{compute:new Ie(t,o,`GSplatIntervalCull${s}`),bindGroupFormat:r}}_getCullCompute(e){if(e){if(!this._cullComputeFisheye){let{compute:t,bindGroupFormat:s}=this._createCullPass(!0);this._cullComputeFisheye=t,this._cullBindGroupFormatFisheye=s}return this._cullComputeFisheye}if(!this._cullComputePerspective){let{compute:t,bindGroupFormat:s}=this._createCullPass(!1);this._cullComputePerspective=t,this._cullBindGroupFormatPerspective=s}return this._cullComputePerspective}_createScatterCompute(){let e=this.device;this._scatterBindGroupFormat=new Ae(e,[new De("uniforms",B),new V("intervals",B,!0),new V("prefixSumBuffer",B,!0),new V("compactedOutput",B,!1)]);let t=new Map([["{WORKGROUP_SIZE}",Xp.toString()]]),s=new be(e,{name:"GSplatIntervalScatter",shaderLanguage:q,cshader:"",cdefines:t,computeBindGroupFormat:this._scatterBindGroupFormat,computeUniformBufferFormats:{uniforms:this._scatterUniformBufferFormat}});this._scatterCompute=new Ie(e,s,"GSplatIntervalScatter")}_createWriteIndirectArgsCompute(){let e=this.device;this._writeArgsBindGroupFormat=new Ae(e,[new V("prefixSumBuffer",B,!0),new V("indirectDrawArgs",B,!1),new V("numSplatsBuf",B,!1),new V("indirectDispatchArgs",B,!1),new V("sortElementCountBuf",B,!1),new De("uniforms",B)]);let t=new Map([["{INSTANCE_SIZE}",Ce.instanceSize],["{KEYGEN_THREADS_PER_WORKGROUP}",256],["{MAX_WORKGROUPS_PER_DIM}",e.limits.maxComputeWorkgroupsPerDimension||65535]]),s=new be(e,{name:"GSplatIntervalWriteIndirectArgs",shaderLanguage:q,cshader:"",cdefines:t,computeBindGroupFormat:this._writeArgsBindGroupFormat,computeUniformBufferFormats:{uniforms:this._writeArgsUniformBufferFormat}});this._writeIndirectArgsCompute=new Ie(e,s,"GSplatIntervalWriteIndirectArgs")}_ensureCapacity(e,t){this.compactedSplatIds=this._scratch.ensureCompactedSplatIds(t);let s=e+1;s>this.allocatedCountBufferSize&&(this.countBuffer?.destroy(),this.allocatedCountBufferSize=s,this.countBuffer=new re(this.device,s*4),this.prefixSumKernel&&this.prefixSumKernel.destroyPasses())}invalidateUpload(){this._uploadedVersion=-1}uploadIntervals(e){if(e.version===this._uploadedVersion)return;this._uploadedVersion=e.version;let t=e.totalIntervals;if(t===0)return;t>this.allocatedIntervalCount&&(this.intervalsBuffer?.destroy(),this.allocatedIntervalCount=t,this.intervalsBuffer=new re(this.device,t*4*4,8));let s=Ax(e);this.intervalsBuffer.write(0,s,0,t*4)}dispatchCompact(e,t,s,r){if(t===0)return;this._ensureCapacity(t,s);let i=this._getCullCompute(r);i.setParameter("intervals",this.intervalsBuffer),i.setParameter("countBuffer",this.countBuffer),i.setParameter("boundsBuffer",e.boundsBuffer),i.setParameter("transformsBuffer",e.transformsBuffer),r?(i.setParameter("cameraWorldPos",e.fisheyeCameraPos),i.setParameter("maxTheta",e.fisheyeMaxTheta),i.setParameter("cameraForward",e.fisheyeCameraForward)):i.setParameter("frustumPlanes[0]",e.frustumPlanes),i.setParameter("numIntervals",t);let a=Math.ceil(t/Xp);i.setupDispatch(a),this.device.computeDispatch([i],"GSplatIntervalCull");let o=t+1;this.prefixSumKernel.resize(this.countBuffer,o),this.prefixSumKernel.dispatch(this.device);let n=this._scatterCompute;n.setParameter("intervals",this.intervalsBuffer),n.setParameter("prefixSumBuffer",this.countBuffer),n.setParameter("compactedOutput",this.compactedSplatIds),n.setParameter("numIntervals",t),n.setParameter("pad0",0),n.setParameter("pad1",0),n.setParameter("pad2",0),Ie.calcDispatchSize(t,this._scatterDispatchSize,this.device.limits.maxComputeWorkgroupsPerDimension||65535),n.setupDispatch(this._scatterDispatchSize.x,this._scatterDispatchSize.y,1),this.device.computeDispatch([n],"GSplatIntervalScatter")}writeIndirectArgs(e,t,s,r){let i=this._writeIndirectArgsCompute;i.setParameter("prefixSumBuffer",this.countBuffer),i.setParameter("indirectDrawArgs",this.device.indirectDrawBuffer),i.setParameter("numSplatsBuf",this.numSplatsBuffer),i.setParameter("indirectDispatchArgs",this.device.indirectDispatchBuffer),i.setParameter("sortElementCountBuf",this.sortElementCountBuffer),i.setParameter("drawSlot",e),i.setParameter("indexCount",sI),i.setParameter("dispatchSlotBase",t),i.setParameter("totalSplats",s),i.setParameter("sortIndirectInfo",r),i.setupDispatch(1),this.device.computeDispatch([i],"GSplatIntervalWriteIndirectArgs")}};var Px=new N,rI=new N,Yp=new y,Dx=new y,Oi=new y,iI=new Uint32Array(4),aI=l=>{let e=Ai[l];return!e||l===Ut?Ai[Oa]:e},vf=class extends mo{_material;meshInstance;_pickMaterial=null;_pickMeshInstance=null;_clipToViewZ=new Float32Array(4);_clipToViewZPick=null;originalBlendType=ir;stochastic=!1;dither=Oa;_internalDefines=new Set;_lastSourceChunksKey="";_sourceMaterialVersion=-1;_cacheStride=8;gpuSorter=null;projector=null;intervalCompaction=null;_scratch=null;indirectDrawSlot=-1;indirectDispatchSlot=-1;lastCompactedNumIntervals=0;constructor(e,t,s,r,i,a=null){super(e,t,s,r,i),this._scratch=a,this._material=new st({uniqueName:"UnifiedSplatHybridMaterial",vertexWGSL:'#include "gsplatHybridVS"',fragmentWGSL:'#include "gsplatPS"',attributes:{vertex_position:le}}),this._material.setDefine("{GSPLAT_INSTANCE_SIZE}",Ce.instanceSize),this._material.setDefine("{CACHE_STRIDE}",8),this.configureMaterial(),this._material.defines.forEach((o,n)=>{this._internalDefines.add(n)}),this._internalDefines.add("{GSPLAT_INSTANCE_SIZE}"),this._internalDefines.add("{CACHE_STRIDE}"),this._internalDefines.add("GSPLAT_UNIFIED_ID"),this._internalDefines.add("PICK_CUSTOM_ID"),this._internalDefines.add("GSPLAT_OVERDRAW"),this._internalDefines.add("GSPLAT_NO_FOG"),this._internalDefines.add("GSPLAT_NO_TONEMAP"),this._internalDefines.add("GSPLAT_XR"),this._internalDefines.add("GSPLAT_STOCHASTIC"),this._internalDefines.add("DITHER_NONE"),this._internalDefines.add("STD_OPACITY_DITHER"),this.meshInstance=this.createMeshInstance()}setRenderMode(e){let s=((this.renderMode??0)&Et)!==0,r=(e&Et)!==0;s&&!r&&this.layer.removeMeshInstances([this.meshInstance],!0),!s&&r&&this.layer.addMeshInstances([this.meshInstance],!0),super.setRenderMode(e)}destroy(){this.renderMode&&this.renderMode&Et&&this.layer.removeMeshInstances([this.meshInstance],!0),this.gpuSorter?.destroy(),this.gpuSorter=null,this.projector?.destroy(),this.projector=null,this.intervalCompaction?.destroy(),this.intervalCompaction=null,this._material.destroy(),this._pickMaterial?.destroy(),this.meshInstance.destroy(),this._pickMeshInstance?.destroy(),super.destroy()}get material(){return this._material}get usesGpuSort(){return!0}get requiresBounds(){return!0}onWorkBufferFormatChanged(){this.configureMaterial()}configureMaterial(){this._material.setDefine("SH_BANDS","0"),this._material.setDefine("GSPLAT_INDIRECT_DRAW",!0),this._updateIdDefines(this._material);let e=this.stochastic;this._material.setDefine("GSPLAT_STOCHASTIC",e),this._material.setDefine("DITHER_NONE",e?void 0:""),this._material.setDefine("STD_OPACITY_DITHER",e?aI(this.dither):void 0),this._material.cull=0;let t=e?tt:fs;this._material.getDefine("GSPLAT_OVERDRAW")?this.originalBlendType=t:this._material.blendType=t,this._material.depthWrite=!!e,this._material.update()}setStereo(e){this._material.getDefine("GSPLAT_XR")!==e&&(this._material.setDefine("GSPLAT_XR",e),this._material.update())}update(e,t){this.meshInstance.instancingCount<=0&&(this.meshInstance.instancingCount=1),this.meshInstance.visible=e>0}invalidateCullUpload(){this.intervalCompaction?.invalidateUpload()}_ensureGpuPipeline(e){e&&!this.gpuSorter&&(this.gpuSorter=new xd(this.device,{indirect:!0})),this.projector||(this.projector=new Cf(this.device)),this.intervalCompaction||(this.intervalCompaction=new po(this.device,this._scratch))}prepareRenderView(e,t,s){(this.stochastic!==!!s.stochastic||this.dither!==s.dither)&&(this.stochastic=!!s.stochastic,this.dither=s.dither,this.configureMaterial());let r=s.cameraNode,i=r.camera,a=i.camera,o=i.renderTarget,n=i.rect,c=a.xrActive?a.xrViews[0]??null:null,h=Math.floor((c?c.viewport.z:o?o.width:this.device.width)*n.z),d=Math.floor((c?c.viewport.w:o?o.height:this.device.height)*n.w),f=a.xrActive?a.xrViews.length:0;f>2;let u=f===2;this.setStereo(u);let m=this.sortAndProjectForCamera(e,t,r,h,d,Math.max(Lp,s.alphaClipForward),!1,u,s);return m?(this.setHybridSortedRendering(this.indirectDrawSlot,m,this.projector.projCache,this.intervalCompaction.numSplatsBuffer),!0):!1}preparePickingView(e,t,s){let r=this.sortAndProjectForCamera(e,t,s.cameraNode,s.width,s.height,Math.max(Lp,s.alphaClip),!0,!1,s);return r?this.prepareForPicking(this.indirectDrawSlot,r,this.projector.projCache,this.intervalCompaction.numSplatsBuffer,s.alphaClip,s.alphaClipForward,s.cameraNode):null}sortAndProjectForCamera(e,t,s,r,i,a,o,n,c){let h=t.totalActiveSplats;if(h===0)return null;let d=o&&!!e.workBuffer.format.getStream("pcId"),f=!!c.stochastic&&!o;this._ensureGpuPipeline(!f);let u=this.gpuSorter,m=this.projector;if(this.intervalCompaction.uploadIntervals(t),e.hasBounds){let A=e.getState(e.currentVersion);A&&this._runFrustumCulling(e,A,s,c)}let _=this.fisheyeProj,p=t.totalIntervals,g=t.totalActiveSplats;this.intervalCompaction.dispatchCompact(e.workBuffer.frustumCuller,p,g,_.enabled);let T=f?iI:u.prepareIndirect();this.allocateAndWriteIntervalIndirectArgs(p,T);let S=this.intervalCompaction,x=S.compactedSplatIds,C=0,E=0,v=1;if(!f){let A=Math.max(10,Math.min(20,Math.round(Math.log2(h/4))));C=Math.ceil(A/u.radixBits)*u.radixBits,{minDist:E,maxDist:v}=this.computeDistanceRange(t,s,c.radialSorting)}return m.dispatch({workBuffer:e.workBuffer,cameraNode:s,compactedSplatIds:x,sortElementCountBuffer:S.sortElementCountBuffer,totalCapacity:h,radialSort:c.radialSorting,stochastic:f,numBits:C,minDist:E,maxDist:v,alphaClip:a,minPixelSize:c.minPixelSize*.5,minContribution:c.minContribution,foveationStrength:c.foveationStrength,foveationCenter:c.foveationCenter,viewportWidth:r,viewportHeight:i,pickMode:d,fisheyeProj:_,antiAlias:c.antiAlias,isStereo:n,material:c.material,userCacheWords:c.varyings.words}),m.writeIndirectArgs(this.indirectDrawSlot,this.indirectDispatchSlot+1,S.numSplatsBuffer,S.sortElementCountBuffer,T),o&&this.device.submit(),f?m.sortKeys:u.sortIndirect(m.sortKeys,h,C,this.indirectDispatchSlot+1,S.sortElementCountBuffer,void 0,!1,!0)}allocateAndWriteIntervalIndirectArgs(e,t){let s=t[0];this.indirectDrawSlot=this.device.getIndirectDrawSlot(1),this.indirectDispatchSlot=this.device.getIndirectDispatchSlot(1+s),this.intervalCompaction.writeIndirectArgs(this.indirectDrawSlot,this.indirectDispatchSlot,e,t),this.lastCompactedNumIntervals=e}_runFrustumCulling(e,t,s,r){e.workBuffer.frustumCuller.updateTransformsData(t.boundsGroups);let i=s.camera,a=i.camera;a.xrViews?.length?(a.updateXrFrustum(),e.workBuffer.frustumCuller.setFrustumPlanes(a.frustum)):e.workBuffer.frustumCuller.computeFrustumPlanes(i.projectionMatrix,i.viewMatrix);let n=this.fisheyeProj;n.update(this.resolveFisheye(r.fisheye),i.fov,i.projectionMatrix),n.enabled&&e.workBuffer.frustumCuller.setFisheyeData(s.getPosition(),s.forward,n.maxTheta)}computeDistanceRange(e,t,s){let r=t.getWorldTransform();r.getTranslation(Yp),r.getZ(Dx).normalize();let i=s?0:1/0,a=s?0:-1/0;for(let o of e.splats){let n=o.node.getWorldTransform(),c=o.aabb.getMin(),h=o.aabb.getMax();for(let d=0;d<8;d++)if(Oi.x=d&1?h.x:c.x,Oi.y=d&2?h.y:c.y,Oi.z=d&4?h.z:c.z,n.transformPoint(Oi,Oi),s){let f=Oi.distance(Yp);f>a&&(a=f)}else{let f=Oi.sub(Yp).dot(Dx);f<i&&(i=f),f>a&&(a=f)}}return a===0||a===-1/0?{minDist:0,maxDist:1}:{minDist:i,maxDist:a}}setHybridSortedRendering(e,t,s,r){this.meshInstance.setIndirect(null,e,1),this._material.setParameter("sortedIndices",t),this._material.setParameter("projCache",s),this._material.setParameter("numSplatsStorage",r),this._computeClipToViewZ(this.cameraNode,this._clipToViewZ),this._material.setParameter("clipToViewZ",this._clipToViewZ),this.meshInstance.visible=!0,this.meshInstance.instancingCount<=0&&(this.meshInstance.instancingCount=1)}prepareForPicking(e,t,s,r,i,a,o){if(this._pickMaterial)this._updateIdDefines(this._pickMaterial)&&this._pickMaterial.update();else{this._pickMaterial=new st({uniqueName:"UnifiedSplatHybridPickMaterial",vertexWGSL:'#include "gsplatHybridVS"',fragmentWGSL:'#include "gsplatPS"',attributes:{vertex_position:le}}),this._pickMaterial.setDefine("{GSPLAT_INSTANCE_SIZE}",Ce.instanceSize),this._pickMaterial.setDefine("{CACHE_STRIDE}",this._cacheStride),this._pickMaterial.setDefine("SH_BANDS","0"),this._pickMaterial.setDefine("GSPLAT_INDIRECT_DRAW",!0),this._pickMaterial.setDefine("DITHER_NONE",""),this._updateIdDefines(this._pickMaterial),this._pickMaterial.cull=0,this._pickMaterial.blendType=tt,this._pickMaterial.depthWrite=!1,this._pickMaterial.update();let h=Ce.createMesh(this.device);this._pickMeshInstance=new nt(h,this._pickMaterial),this._pickMeshInstance.node=this.node,this._pickMeshInstance.setInstancing(!0,!0),this._pickMeshInstance.instancingCount=1}let n=this._pickMaterial,c=this._pickMeshInstance;return c.setIndirect(null,e,1),n.setParameter("sortedIndices",t),n.setParameter("projCache",s),n.setParameter("numSplatsStorage",r),n.setParameter("alphaClip",i),n.setParameter("alphaClipForward",a),this._clipToViewZPick??(this._clipToViewZPick=new Float32Array(4)),this._computeClipToViewZ(o,this._clipToViewZPick),n.setParameter("clipToViewZ",this._clipToViewZPick),c}_computeClipToViewZ(e,t){let s=e.camera.camera;if(this.fisheyeProj.enabled){let i=s.nearClip,a=s.farClip;t[0]=0,t[1]=0,t[2]=a-i,t[3]=i;return}Px.copy(Vt.applyShaderProjectionTransform(s.projectionMatrix,rI,!1,this.device.isWebGPU)).invert();let r=Px.data;t[0]=-r[2],t[1]=-r[6],t[2]=-r[10],t[3]=-r[14]}setCpuSortedRendering(){this.meshInstance.setIndirect(null,-1),this.meshInstance.visible=!1}setOrderData(){}frameUpdate(e){this._material.sceneTexturesWrite=e.sceneDepthWrite,this._material.setParameter("alphaClip",e.alphaClip),this._material.setParameter("alphaClipForward",e.alphaClipForward),this._pickMaterial?.setParameter("alphaClip",e.alphaClip),this._pickMaterial?.setParameter("alphaClipForward",e.alphaClipForward),e.colorRamp&&this._material.setParameter("colorRampIntensity",e.colorRampIntensity);let t=!e.useFog,s=!e.useTonemap;(t!==this._lastNoFog||s!==this._lastNoTonemap)&&(this._lastNoFog=t,this._lastNoTonemap=s,this._material.setDefine("GSPLAT_NO_FOG",t),this._material.setDefine("GSPLAT_NO_TONEMAP",s),this._material.update());let r=8+e.varyings.words;r!==this._cacheStride&&(this._cacheStride=r,this._material.setDefine("{CACHE_STRIDE}",r),this._material.update(),this._pickMaterial&&(this._pickMaterial.setDefine("{CACHE_STRIDE}",r),this._pickMaterial.update()));let i=e.material.updateVersion;this._sourceMaterialVersion!==i&&(this.copyMaterialSettings(e.material),this._sourceMaterialVersion=i)}copyMaterialSettings(e){let t=[];this._material.defines.forEach((r,i)=>{!this._internalDefines.has(i)&&!e.defines.has(i)&&t.push(i)}),t.forEach(r=>this._material.setDefine(r,void 0)),e.defines.forEach((r,i)=>{this._material.setDefine(i,r)});let s=e.parameters;for(let r in s)s.hasOwnProperty(r)&&this._material.setParameter(r,s[r].data);if(e.hasShaderChunks){let r=e.shaderChunks.key;r!==this._lastSourceChunksKey&&(this._material.shaderChunks.copy(e.shaderChunks),this._lastSourceChunksKey=r)}this._material.update()}_updateIdDefines(e){let t=!!this.workBuffer.format.getStream("pcId"),s=e.getDefine("GSPLAT_UNIFIED_ID")!==t||e.getDefine("PICK_CUSTOM_ID")!==t;return e.setDefine("GSPLAT_UNIFIED_ID",t),e.setDefine("PICK_CUSTOM_ID",t),s}updateOverdrawMode(e){let t=!!e.colorRamp,s=this._material.getDefine("GSPLAT_OVERDRAW");t&&(this._material.setParameter("colorRamp",e.colorRamp),this._material.setParameter("colorRampIntensity",e.colorRampIntensity)),t!==s&&(this._material.setDefine("GSPLAT_OVERDRAW",t),t?(this.originalBlendType=this._material.blendType,this._material.blendType=ir):this._material.blendType=this.originalBlendType,this._material.update())}createMeshInstance(){let e=Ce.createMesh(this.device),t=new nt(e,this._material);t.node=this.node,t.setInstancing(!0,!0),t.instancingCount=0,t.pick=!1;let s=this.cameraNode.camera;return t.isVisibleFunc=r=>{let i=this.renderMode??0;return s.camera===r&&i&Et?!0:(r.node?.name===Na,!1)},t}};var xf=class{device;compactedSplatIds=null;_allocatedCompacted=0;constructor(e){this.device=e}ensureCompactedSplatIds(e){return e>this._allocatedCompacted&&(this.compactedSplatIds?.destroy(),this._allocatedCompacted=e,this.compactedSplatIds=new re(this.device,e*4,4)),this.compactedSplatIds}destroy(){this.compactedSplatIds?.destroy(),this.compactedSplatIds=null,this._allocatedCompacted=0}};var Ix=256,oI=6*Ce.instanceSize,Af=class{device;node;cameraNode;layer;world;entries=new Map;_desiredLights=new Set;_compaction=null;_cullDispatchSize=new k(1,1);_frustumPlanes=new Float32Array(24);_userChunksKey="";_userModifyWgsl=null;_cullShader=null;_cullBindGroupFormat=null;_cullFormatVersion=-1;_cullBuiltChunksKey=null;_cullShaderGen=0;_argsShader=null;_argsBindGroupFormat=null;constructor(e,t,s,r,i,a=null){this.device=e,this.node=t,this.cameraNode=s,this.layer=r,this.world=i,this._compaction=new po(e,a),this._createArgsShader()}destroy(){this.entries.forEach(e=>this._destroyEntry(e)),this.entries.clear(),this._compaction?.destroy(),this._compaction=null,this._cullShader?.destroy(),this._cullBindGroupFormat?.destroy(),this._argsShader?.destroy(),this._argsBindGroupFormat?.destroy(),this._cullShader=null,this._argsShader=null}_ensureCullShader(){let t=this.world.workBuffer.format.extraStreamsVersion;(!this._cullShader||t!==this._cullFormatVersion||this._userChunksKey!==this._cullBuiltChunksKey)&&(this._cullFormatVersion=t,this._cullBuiltChunksKey=this._userChunksKey,this._buildCullShader())}_buildCullShader(){let e=this.device,t=this.world.workBuffer.format,s=[new De("uniforms",B),new V("compactedSplatIds",B,!0),new V("candidateCountBuffer",B,!0),new V("outputIndices",B,!1),new V("globalCount",B,!1)];this._cullBindGroupFormat?.destroy(),this._cullBindGroupFormat=new Ae(e,[...s,...t.getComputeBindFormats()]);let r=new Te(e,[new I("frustumPlanes",Pe,6),new I("numIntervals",X),new I("splatTextureSize",X),new I("alphaClip",b),new I("worldSizeThreshold",b)]),i=new Map;i.set("gsplatComputeSplatCS",""),i.set("gsplatFormatDeclCS",t.getComputeInputDeclarations(s.length)),i.set("gsplatFormatReadCS",t.getReadCode()),i.set("gsplatHelpersVS",""),i.set("gsplatModifyVS",this._userModifyWgsl??"");let a=new Map([["{WORKGROUP_SIZE}",Ix.toString()]]),o=t.getStream("dataColor");o&&o.format!==_t&&a.set("GSPLAT_COLOR_FLOAT",""),this._cullShader?.destroy(),this._cullShader=new be(e,{name:"GSplatShadowCull",shaderLanguage:q,cshader:"",cincludes:i,cdefines:a,computeBindGroupFormat:this._cullBindGroupFormat,computeUniformBufferFormats:{uniforms:r}}),this._cullShaderGen++}_createArgsShader(){let e=this.device;this._argsBindGroupFormat=new Ae(e,[new V("countBuffer",B,!0),new V("indirectDrawArgs",B,!1),new De("uniforms",B)]);let t=new Te(e,[new I("drawSlot",X),new I("indexCount",X),new I("pad0",X),new I("pad1",X)]);this._argsShader=new be(e,{name:"GSplatShadowIndirectArgs",shaderLanguage:q,cshader:"",cdefines:new Map([["{INSTANCE_SIZE}",Ce.instanceSize.toString()]]),computeBindGroupFormat:this._argsBindGroupFormat,computeUniformBufferFormats:{uniforms:t}})}setDataSource(e){this._compaction?.invalidateUpload(),this._cullFormatVersion=-1,this.entries.forEach(t=>{this._configureMaterialWorkBuffer(t.material),t.material.update()})}setCastersAabb(e){e&&this.entries.forEach(t=>{t.meshInstance.setCustomAabb(e)})}syncLights(){let e=this.layer.getLightList().directional,t=this._desiredLights;t.clear();for(let s=0;s<e.length;s++){let r=e[s];!r.enabled||!r.castShadows||r.numCascades===1&&t.add(r)}this.entries.forEach((s,r)=>{t.has(r)||(this._destroyEntry(s),this.entries.delete(r))}),t.forEach(s=>{this.entries.has(s)||this.entries.set(s,this._createEntry(s))})}cull(e){let t=this.world.getState(this.world.currentVersion);if(!(t&&t.sortedBefore&&t.totalActiveSplats>0)){this.entries.forEach(c=>{c.meshInstance.visible=!1});return}let r=t.totalIntervals,i=t.totalActiveSplats,a=this.world.workBuffer.textureSize,o=!1,n=this.cameraNode.camera?.camera;this.entries.forEach(c=>{let{light:h}=c;if(!Wm(h)||!n)return;let d=h.getRenderData(n,0);!d.shadowCullRequested||!(d.shadowCascadeMask&1)||(o||(o=!0,this._compaction.uploadIntervals(t),this.world.workBuffer.frustumCuller.updateTransformsData(t.boundsGroups),this._syncUserModify(e),this._ensureCullShader()),this._cullEntry(c,r,i,a,e))})}_syncUserModify(e){let t=e.material;if(!t)return;let s=t.shaderChunks?.key??"";s!==this._userChunksKey&&(this._userChunksKey=s,this._userModifyWgsl=t.getShaderChunks?.("wgsl")?.get("gsplatModifyVS")??null,this.entries.forEach(i=>this._applyUserModify(i)));let r=t.parameters;this.entries.forEach(i=>{for(let a in r)r.hasOwnProperty(a)&&i.material.setParameter(a,r[a].data)})}_applyUserModify(e){let t=e.material.shaderChunks.wgsl;this._userModifyWgsl?t.set("gsplatModifyVS",this._userModifyWgsl):t.delete("gsplatModifyVS"),e.material.update()}_cullEntry(e,t,s,r,i){let a=this.device,o=this.cameraNode.camera?.camera,n=o&&e.light.getRenderData(o,0).shadowCamera,c=n&&n.frustum,h=this.world.workBuffer.frustumCuller;if(!c||!h?.boundsBuffer||!h?.transformsBuffer){e.meshInstance.visible=!1;return}this._fillFrustumPlanes(c);let d=n.orthoHeight,f=e.light._shadowResolution,u=i.minPixelSize,m=d>0&&f>0?f/d:0,_=u*u*.5-.3,p=m>0&&_>0?Math.sqrt(_)/m:0;s>e.allocatedIndexCount&&(e.indexBuffer?.destroy(),e.allocatedIndexCount=s,e.indexBuffer=new re(a,s*4));let g=this._compaction;g.dispatchCompact({boundsBuffer:h.boundsBuffer,transformsBuffer:h.transformsBuffer,frustumPlanes:this._frustumPlanes},t,s,!1),e.countBuffer.clear(),(!e.cullCompute||e.cullComputeGen!==this._cullShaderGen)&&(e.cullCompute?.destroy(),e.cullCompute=new Ie(a,this._cullShader,"GSplatShadowCull"),e.cullComputeGen=this._cullShaderGen);let T=e.cullCompute,S=i.material;if(S){let D=S.parameters;for(let R in D)D.hasOwnProperty(R)&&T.setParameter(R,D[R].data)}T.setParameter("compactedSplatIds",g.compactedSplatIds),T.setParameter("candidateCountBuffer",g.countBuffer),T.setParameter("outputIndices",e.indexBuffer),T.setParameter("globalCount",e.countBuffer),T.setParameter("frustumPlanes[0]",this._frustumPlanes),T.setParameter("numIntervals",t),T.setParameter("splatTextureSize",r),T.setParameter("alphaClip",i.alphaClip),T.setParameter("worldSizeThreshold",p);let x=this.world.workBuffer;for(let D of x.format.resourceStreams){let R=x.getTexture(D.name);R&&T.setParameter(D.name,R)}let C=Math.ceil(s/Ix);Ie.calcDispatchSize(C,this._cullDispatchSize,a.limits.maxComputeWorkgroupsPerDimension||65535),T.setupDispatch(this._cullDispatchSize.x,this._cullDispatchSize.y,1),a.computeDispatch([T],"GSplatShadowCull");let E=a.getIndirectDrawSlot(1),v=e.argsCompute;v.setParameter("countBuffer",e.countBuffer),v.setParameter("indirectDrawArgs",a.indirectDrawBuffer),v.setParameter("drawSlot",E),v.setParameter("indexCount",oI),v.setParameter("pad0",0),v.setParameter("pad1",0),v.setupDispatch(1),a.computeDispatch([v],"GSplatShadowIndirectArgs");let A=e.material;e.meshInstance.setIndirect(null,E,1),A.setParameter("compactedSplatIds",e.indexBuffer),A.setParameter("numSplatsStorage",e.countBuffer),A.setParameter("splatTextureSize",r),A.setParameter("alphaClip",i.alphaClip),e.meshInstance.visible=!0,e.meshInstance.instancingCount<=0&&(e.meshInstance.instancingCount=1)}_fillFrustumPlanes(e){this._frustumPlanes.set(e.planeData)}_createEntry(e){let t=this.device,s=this._createMaterial(),r=this._createMeshInstance(e,s);r.castShadow=!0,this.layer.addShadowCasters([r]);let i=new re(t,4,8),a=new Ie(t,this._argsShader,"GSplatShadowIndirectArgs"),o={light:e,material:s,meshInstance:r,indexBuffer:null,allocatedIndexCount:0,countBuffer:i,cullCompute:null,cullComputeGen:-1,argsCompute:a};return this._applyUserModify(o),o}_destroyEntry(e){this.layer.removeShadowCasters([e.meshInstance]),e.meshInstance.destroy(),e.material.destroy(),e.indexBuffer?.destroy(),e.countBuffer.destroy(),e.cullCompute?.destroy(),e.argsCompute.destroy()}_createMaterial(){let e=new st({uniqueName:"GSplatShadowMaterial",vertexGLSL:'#include "gsplatVS"',fragmentGLSL:'#include "gsplatPS"',vertexWGSL:'#include "gsplatVS"',fragmentWGSL:'#include "gsplatPS"',attributes:{vertex_position:le}});return e.setDefine("{GSPLAT_INSTANCE_SIZE}",Ce.instanceSize),e.setDefine("SH_BANDS","0"),e.setDefine("GSPLAT_SEPARATE_OPACITY",""),e.setDefine("DITHER_NONE",""),e.setDefine("GSPLAT_INDIRECT_DRAW",!0),this._configureMaterialWorkBuffer(e),e.cull=0,e.blendType=fs,e.depthWrite=!1,e.update(),e}_configureMaterialWorkBuffer(e){let t=this.world.workBuffer,s=t.format,r=this.device.isWebGPU?e.shaderChunks.wgsl:e.shaderChunks.glsl;r.set("gsplatDeclarationsVS",s.getInputDeclarations()),r.set("gsplatReadVS",s.getReadCode());let i=s.getStream("dataColor");i&&i.format!==_t&&e.setDefine("GSPLAT_COLOR_FLOAT","");let a=!!s.getStream("pcId");e.setDefine("GSPLAT_UNIFIED_ID",a),e.setDefine("PICK_CUSTOM_ID",a);for(let o of s.resourceStreams){let n=t.getTexture(o.name);n&&e.setParameter(o.name,n)}}_createMeshInstance(e,t){let s=Ce.createMesh(this.device),r=new nt(s,t);r.node=this.node,r.setInstancing(!0,!0),r.instancingCount=0,r.pick=!1;let i=this.cameraNode;return r.isVisibleFunc=a=>{let o=i.camera?.camera;return o?a===e.getRenderData(o,0).shadowCamera:!1},r}};var jp=new y,Zn=new y,wx=new y,Rf=new y,Mx=new N,jQ=[new z(1,0,0),new z(0,1,0),new z(0,0,1),new z(1,1,0),new z(1,0,1),new z(0,1,1),new z(1,.5,0),new z(.5,0,1)],Pf=class{device;node=new wt("GSplatManager");world;gsplat;renderer;shadowRenderer=null;_hybridScratch=null;activeRenderer;cpuSorter=null;_centersVersions=new Map;lastSortCameraPos=new y(1/0,1/0,1/0);lastSortCameraFwd=new y(1/0,1/0,1/0);sortNeeded=!0;_deviceRestoredEvent=null;cameraNode;scene;renderMode;_updateResult={newVersion:!1,overdrawDirty:!1,sortNeeded:!1};_bakeResult={rebuilt:!1,count:0,textureSize:0,sortNeeded:!1};_markResult={rebuilt:!1,count:0,textureSize:0};_formatResult={bufferRecreated:!1,sortNeeded:!1};_lastStreamToken=-1;_streamAdvanced=!1;_renderViewParams={};_pickParams={};constructor(e,t,s,r){this.device=e,this.scene=t.scene,this.gsplat=t.gsplat,this.director=t,this.cameraNode=r,this.world=new Ef(e,this.scene,this.gsplat),this.layer=s,this._createRenderer(this.gsplat.currentRenderer),this._deviceRestoredEvent=this.device.on("devicerestored",this._onDeviceRestored,this)}destroy(){this._destroyed=!0,this._deviceRestoredEvent?.off(),this._deviceRestoredEvent=null,this.destroyCpuSorting(),this.world.destroy(),this.renderer.destroy(),this.shadowRenderer?.destroy(),this.shadowRenderer=null,this._hybridScratch?.destroy(),this._hybridScratch=null}_onDeviceRestored(){this.world.hasOctreeInstances||(this.world.invalidate({workBuffer:!0}),this.sortNeeded=!0)}destroyCpuSorting(){this.cpuSorter?.destroy(),this.cpuSorter=null}initCpuSorting(){this.cpuSorter||(this.cpuSorter=this.createSorter());let e=this.world.invalidateSortState();e&&this.cpuSorter.updateCentersForSplats(e),this.renderer.setCpuSortedRendering()}get material(){return this.renderer.material}get bufferCopyUploaded(){return this.world.bufferCopyUploaded}get bufferCopyTotal(){return this.world.bufferCopyTotal}get hasPendingSort(){return!!this.cpuSorter?.pendingSorted}prepareForPicking(e,t,s){if(!this.renderer.usesGpuSort||!e.node)return null;let r=this.world.getState(this.world.currentVersion);return r?.sortedBefore?this.renderer.preparePickingView(this.world,r,this._fillPickParams(e,t,s)):null}_writeGsplatParams(e){let t=this.gsplat;e.radialSorting=t.radialSorting,e.stochastic=t.stochastic,e.dither=t.dither,e.alphaClip=t.alphaClip,e.alphaClipForward=t.alphaClipForward,e.minPixelSize=t.minPixelSize,e.minContribution=t.minContribution,e.foveationStrength=t.foveationStrength,e.foveationCenter=t.foveationCenter,e.antiAlias=t.antiAlias,e.fisheye=t.fisheye,e.material=t.material,e.varyings=t.varyings}_fillRenderViewParams(){let e=this._renderViewParams;return this._writeGsplatParams(e),e.cameraNode=this.cameraNode,e}_fillPickParams(e,t,s){let r=this._pickParams;return this._writeGsplatParams(r),r.stochastic=!1,r.cameraNode=e.node,r.width=t,r.height=s,r}createSorter(){let e=new af(this.scene);return e.on("sorted",(t,s,r)=>{this.onSorted(t,s,r)}),e}setRenderMode(e){this.renderMode=e,this.renderer.setRenderMode(e),this._syncShadowRenderer()}_syncShadowRenderer(){let e=!!(this.renderMode&Ms)&&this.renderer.usesGpuSort;e&&!this.shadowRenderer?this.shadowRenderer=new Af(this.device,this.node,this.cameraNode,this.layer,this.world,this._hybridScratch):!e&&this.shadowRenderer&&(this.shadowRenderer.destroy(),this.shadowRenderer=null),!this.renderer.usesGpuSort&&this._hybridScratch&&(this._hybridScratch.destroy(),this._hybridScratch=null)}_createRenderer(e){let t=this.world.workBuffer;e===cn?(this._hybridScratch??(this._hybridScratch=new xf(this.device)),this.renderer=new vf(this.device,this.node,this.cameraNode,this.layer,t,this._hybridScratch)):(this.renderer=new yf(this.device,this.node,this.cameraNode,this.layer,t),this.initCpuSorting()),this.activeRenderer=e}prepareRendererMode(){let e=this.gsplat.currentRenderer;e!==this.activeRenderer&&(this.world.invalidate({worldState:!0}),this.destroyCpuSorting(),this.renderer.destroy(),this._createRenderer(e),this.renderer.setRenderMode(this.renderMode),this._syncShadowRenderer(),this.world.invalidate({workBuffer:!0}),this.sortNeeded=!0)}reconcile(e){this.world.reconcile(e)}onSorted(e,t,s){let r=this.renderer.requiresBounds,i=this.world.onSorted(t,e,s,this.cameraNode,r,this._markResult);i.rebuilt&&this.renderer.update(i.count,i.textureSize),this.renderer.setOrderData()}_markSortedIfNeeded(e){e.sortedBefore||(this.world.markSorted(e.version,e.totalActiveSplats,this.cameraNode,!0,this._markResult),this._markResult.rebuilt&&this.renderer.update(this._markResult.count,this._markResult.textureSize))}testCameraMovedForSort(){if(this.gsplat.radialSorting){let t=this.cameraNode.getPosition();return this.lastSortCameraPos.distance(t)>.001}if(Number.isFinite(this.lastSortCameraFwd.x)){let t=this.cameraNode.forward,s=Math.min(1,Math.max(-1,this.lastSortCameraFwd.dot(t)));return Math.acos(s)>.001}return!0}fireFrameReadyEvent(){let e=this.world.currentVersion===this.world.lastWorldStateVersion&&!this.world.awaitingLodUpdate,t=this.world.pendingLoadCount;this.director.eventHandler.fire("frame:ready",this.cameraNode.camera,this.renderer.layer,e,t)}updateStreaming(e){if(e===this._lastStreamToken)return this._streamAdvanced;this._lastStreamToken=e,this.world.syncFormat(this._formatResult),this._formatResult.bufferRecreated&&(this.renderer.setDataSource(this.world.workBuffer),this.shadowRenderer?.setDataSource(this.world.workBuffer)),this._formatResult.sortNeeded&&(this.sortNeeded=!0),this.prepareRendererMode();let t=!this.renderer.requiresCpuSort||this.cpuSorter&&this.cpuSorter.jobsInFlight<3;return this.world.update(this.cameraNode,t,!!this.cpuSorter,this._updateResult),this._updateResult.overdrawDirty&&this.renderer.updateOverdrawMode(this.gsplat),this._updateResult.sortNeeded&&(this.sortNeeded=!0),this._updateResult.newVersion&&this._feedCpuSorterCenters(),this.world.tickCooldowns(e),this._streamAdvanced=this._updateResult.newVersion||this._formatResult.bufferRecreated,this._streamAdvanced}update(){this.world.resetFrameStats(),this.updateStreaming(this.director._streamToken),this.cpuSorter&&this.cpuSorter.applyPendingSorted(),this.testCameraMovedForSort()&&(this.sortNeeded=!0);let e=this.world.getState(this.world.lastWorldStateVersion);if(e&&this.cpuSorter&&!e.sortParametersSet){e.sortParametersSet=!0;let i=this.world.prepareSortParameters(e);this.cpuSorter.setSortParameters(i)}let t=this.renderer.requiresBounds;this.world.bake(this.world.currentVersion,this.cameraNode,t,this._bakeResult),this._bakeResult.rebuilt&&(this.renderer.update(this._bakeResult.count,this._bakeResult.textureSize),this.renderer.setOrderData(),this.renderer.invalidateCullUpload()),this._bakeResult.sortNeeded&&(this.sortNeeded=!0),e&&(this.renderer.usesGpuSort?(this._markSortedIfNeeded(e),this.renderMode&Et&&this.renderer.prepareRenderView(this.world,e,this._fillRenderViewParams())):this.sortNeeded&&this.sortCpu(e),this.sortNeeded&&(this.sortNeeded=!1,this.lastSortCameraPos.copy(this.cameraNode.getPosition()),this.lastSortCameraFwd.copy(this.cameraNode.forward))),this.shadowRenderer?.syncLights();let s=this.world.computeAggregateAabb();this.renderer?.meshInstance?.setCustomAabb(s),this.shadowRenderer?.setCastersAabb(s),this.fireFrameReadyEvent(),this.gsplat.dirty&&this.world.markInstancesNeedLodUpdate(),this.renderer.frameUpdate(this.gsplat);let r=this.world.getState(this.world.currentVersion);return r?r.totalActiveSplats:0}updateShadows(){this.shadowRenderer?.cull(this.gsplat)}_feedCpuSorterCenters(){if(!this.cpuSorter)return;let e=this.world.getState(this.world.lastWorldStateVersion);if(!e)return;let t=e.splats;for(let s of t){let r=s.resource;this._centersVersions.get(r.id)!==r.centersVersion&&(this._centersVersions.set(r.id,r.centersVersion),this.cpuSorter.setCenters(r.id,null),this.cpuSorter.setCenters(r.id,r.centers))}this.cpuSorter.updateCentersForSplats(t)}sortCpu(e){if(!this.cpuSorter)return;let s=this.cameraNode.getWorldTransform();s.getTranslation(jp),s.getZ(Zn).normalize();let r=this.gsplat.radialSorting,i=[];e.splats.forEach(a=>{let o=a.node.getWorldTransform();Mx.copy(o).invert();let n=r?o.getX(Rf).length():1,c=new y(o.getX(Rf).dot(Zn),o.getY(Rf).dot(Zn),o.getZ(Rf).dot(Zn)),h=Mx.transformPoint(jp);o.getTranslation(wx);let d=wx.sub(jp).dot(Zn),f=a.aabb.getMin(),u=a.aabb.getMax();i.push({transformedDirection:c,transformedPosition:h,offset:d,scale:n,aabbMin:[f.x,f.y,f.z],aabbMax:[u.x,u.y,u.z]})}),this.cpuSorter.setSortParams(i,r)}};var Df=class{static equals(e,t){if(e.size!==t.size)return!1;for(let s of e)if(!t.has(s))return!1;return!0}};var If=[],qp=new Set,$p=class{gsplatManager=null;gsplatManagerShadow=null;constructor(e,t,s,r){this.updateConfiguration(e,t,s,r)}createManager(e,t,s,r,i,a){let o=new Pf(e,t,s,r);return o.setRenderMode(a),t.eventHandler&&t.eventHandler.fire("material:created",o.material,i,s),o}updateConfiguration(e,t,s,r){let i=r.node,a=s.gsplatPlacements.length>0,o=s.gsplatShadowCasters.length>0,c=Df.equals(s.gsplatPlacementsSet,s.gsplatShadowCastersSet)&&a,h=c?Et|Ms:a?Et:0,d=c?0:o?Ms:0;h?this.gsplatManager?this.gsplatManager.setRenderMode(h):this.gsplatManager=this.createManager(e,t,s,i,r,h):this.gsplatManager&&(this.gsplatManager.destroy(),this.gsplatManager=null),d?this.gsplatManagerShadow?this.gsplatManagerShadow.setRenderMode(d):this.gsplatManagerShadow=this.createManager(e,t,s,i,r,d):this.gsplatManagerShadow&&(this.gsplatManagerShadow.destroy(),this.gsplatManagerShadow=null)}destroy(){this.gsplatManager?.destroy(),this.gsplatManager=null,this.gsplatManagerShadow?.destroy(),this.gsplatManagerShadow=null}},Kp=class{layersMap=new Map;destroy(){this.layersMap.forEach(e=>e.destroy()),this.layersMap.clear()}removeLayerData(e){let t=this.layersMap.get(e);t&&(t.destroy(),this.layersMap.delete(e))}getLayerData(e,t,s,r){let i=this.layersMap.get(s);return i||(i=new $p(e,t,s,r),this.layersMap.set(s,i)),i}},wf=class{device;camerasMap=new Map;scene;gsplat;eventHandler;_streamToken=0;constructor(e,t,s,r,i){this.device=e,this.renderer=t,this.scene=s,this.eventHandler=r,this.gsplat=i}destroy(){this.camerasMap.forEach(e=>e.destroy()),this.camerasMap.clear()}getCameraData(e){let t=this.camerasMap.get(e);return t||(t=new Kp,this.camerasMap.set(e,t)),t}prepareForPicking(e,t,s,r){let i=this.camerasMap.get(e);if(!i)return null;let a=i.layersMap.get(r);return a?.gsplatManager?a.gsplatManager.prepareForPicking(e,t,s):null}updateStreaming(){this.gsplat.frameUpdate(),Ja.process(this.device);let e=++this._streamToken,t=!1,s=!1;this.camerasMap.forEach((r,i)=>{i.node.camera?.camera===i&&r.layersMap.forEach((a,o)=>{o.gsplatPlacementsDirty&&(a.gsplatManager?.reconcile(o.gsplatPlacements),a.gsplatManagerShadow?.reconcile(o.gsplatShadowCasters));let n=a.gsplatManager;n&&(t=n.updateStreaming(e)||t,t=n.hasPendingSort||t,s=!0);let c=a.gsplatManagerShadow;c&&(t=c.updateStreaming(e)||t,t=c.hasPendingSort||t,s=!0)})}),s&&(this.gsplat.dirty=!1),t&&this.eventHandler.fire("frame:request")}update(e){this.camerasMap.forEach((o,n)=>{if(!e.camerasSet.has(n))o.destroy(),this.camerasMap.delete(n);else{o.layersMap.forEach((c,h)=>{(!n.layersSet.has(h.id)||!h.enabled)&&If.push(h)});for(let c=0;c<If.length;c++){let h=If[c],d=o.layersMap.get(h);d&&(d.destroy(),o.layersMap.delete(h))}If.length=0}});let t=e.layerList;for(let o=0;o<t.length;o++){let n=t[o];n.gsplatPlacementsDirty&&(n.gsplatPlacementsDirty=!1,qp.add(n))}let s=0,r=0,i=0,a=e.cameras;for(let o=0;o<a.length;o++){let n=a[o].camera,c=this.camerasMap.get(n),h=n.layers;for(let d=0;d<h.length;d++){let f=e.getLayerById(h[d]);if(f?.enabled){let u=f.gsplatPlacements.length>0,m=f.gsplatShadowCasters.length>0;if(qp.has(f)||(u||m)&&!c?.layersMap.has(f))if(!u&&!m)c&&c.removeLayerData(f);else{c??(c=this.getCameraData(n));let _=c.getLayerData(this.device,this,f,n);_.updateConfiguration(this.device,this,f,n),_.gsplatManager&&_.gsplatManager.reconcile(f.gsplatPlacements),_.gsplatManagerShadow&&_.gsplatManagerShadow.reconcile(f.gsplatShadowCasters)}}}if(c)for(let d of c.layersMap.values())d.gsplatManager&&(s+=d.gsplatManager.update(),r+=d.gsplatManager.bufferCopyUploaded,i+=d.gsplatManager.bufferCopyTotal),d.gsplatManagerShadow&&(s+=d.gsplatManagerShadow.update(),r+=d.gsplatManagerShadow.bufferCopyUploaded,i+=d.gsplatManagerShadow.bufferCopyTotal)}this.renderer._gsplatCount=s,this.renderer._gsplatBufferCopy=i>0?r/i*100:0,this.gsplat.frameEnd(),qp.clear()}updateShadows(){this.camerasMap.forEach(e=>{e.layersMap.forEach(t=>{t.gsplatManager?.updateShadows(),t.gsplatManagerShadow?.updateShadows()})})}};var Lx=`
uvec4 cachedTransformA;
vec3 getCenter() {
	cachedTransformA = loadDataTransformA();
	return vec3(uintBitsToFloat(cachedTransformA.r), uintBitsToFloat(cachedTransformA.g), uintBitsToFloat(cachedTransformA.b));
}
float getOpacity() {
	return float(cachedTransformA.a >> 24u) / 255.0;
}
vec3 getColor() {
	uint data = loadDataColor().x;
	float r = float(data & 0x7FFu) * (4.0 / 2047.0);
	float g = float((data >> 11u) & 0x7FFu) * (4.0 / 2047.0);
	float b = float((data >> 22u) & 0x3FFu) * (4.0 / 1023.0);
	return vec3(r, g, b);
}
vec4 getRotation() {
	uint data = loadDataTransformB().x;
	vec3 p = vec3(
		float(data & 0x7FFu) / 2047.0 * 2.0 - 1.0,
		float((data >> 11u) & 0x7FFu) / 2047.0 * 2.0 - 1.0,
		float((data >> 22u) & 0x3FFu) / 1023.0 * 2.0 - 1.0
	);
	float d = dot(p, p);
	return vec4(1.0 - d, sqrt(max(0.0, 2.0 - d)) * p);
}
vec3 getScale() {
	uint data = cachedTransformA.a;
	float sx = float(data & 0xFFu);
	float sy = float((data >> 8u) & 0xFFu);
	float sz = float((data >> 16u) & 0xFFu);
	const float logRange = 21.0 / 255.0;
	const float logMin = -12.0;
	return vec3(
		sx == 0.0 ? 0.0 : exp(sx * logRange + logMin),
		sy == 0.0 ? 0.0 : exp(sy * logRange + logMin),
		sz == 0.0 ? 0.0 : exp(sz * logRange + logMin)
	);
}
`;var bx=`
void writeSplat(vec3 center, vec4 rotation, vec3 scale, vec4 color) {
	vec3 rgb = clamp(color.rgb, 0.0, 4.0);
	uint rBits = uint(rgb.r * (2047.0 / 4.0) + 0.5);
	uint gBits = uint(rgb.g * (2047.0 / 4.0) + 0.5);
	uint bBits = uint(rgb.b * (1023.0 / 4.0) + 0.5);
	writeDataColor(uvec4(rBits | (gBits << 11u) | (bBits << 22u), 0u, 0u, 0u));
	#ifndef GSPLAT_COLOR_ONLY
		vec4 q = rotation;
		if (q.w < 0.0) q = -q;
		vec3 p = q.xyz * inversesqrt(1.0 + q.w);
		uint aBitsQ = uint(clamp((p.x * 0.5 + 0.5) * 2047.0 + 0.5, 0.0, 2047.0));
		uint bBitsQ = uint(clamp((p.y * 0.5 + 0.5) * 2047.0 + 0.5, 0.0, 2047.0));
		uint cBitsQ = uint(clamp((p.z * 0.5 + 0.5) * 1023.0 + 0.5, 0.0, 1023.0));
		uint packedQuat = aBitsQ | (bBitsQ << 11u) | (cBitsQ << 22u);
		const float invLogRange = 255.0 / 21.0;
		const float logMin = -12.0;
		uint sxBits = scale.x < 1e-10 ? 0u : uint(clamp((log(scale.x) - logMin) * invLogRange + 0.5, 1.0, 255.0));
		uint syBits = scale.y < 1e-10 ? 0u : uint(clamp((log(scale.y) - logMin) * invLogRange + 0.5, 1.0, 255.0));
		uint szBits = scale.z < 1e-10 ? 0u : uint(clamp((log(scale.z) - logMin) * invLogRange + 0.5, 1.0, 255.0));
		uint alphaBits = uint(clamp(color.a, 0.0, 1.0) * 255.0 + 0.5);
		uint packedScaleAlpha = sxBits | (syBits << 8u) | (szBits << 16u) | (alphaBits << 24u);
		writeDataTransformA(uvec4(floatBitsToUint(center.x), floatBitsToUint(center.y), floatBitsToUint(center.z), packedScaleAlpha));
		writeDataTransformB(uvec4(packedQuat, 0u, 0u, 0u));
	#endif
}
`;var Fx=`
uvec4 cachedTransformA;
uvec2 cachedTransformB;
vec4 cachedColor;
vec3 getCenter() {
	cachedTransformA = loadDataTransformA();
	cachedTransformB = loadDataTransformB().xy;
	return vec3(uintBitsToFloat(cachedTransformA.r), uintBitsToFloat(cachedTransformA.g), uintBitsToFloat(cachedTransformA.b));
}
float getOpacity() {
	#ifdef GSPLAT_COLOR_FLOAT
		cachedColor = loadDataColor();
	#else
		uvec4 packedColor = loadDataColor();
		uint packed_rg = packedColor.r | (packedColor.g << 16u);
		uint packed_ba = packedColor.b | (packedColor.a << 16u);
		cachedColor = vec4(unpackHalf2x16(packed_rg), unpackHalf2x16(packed_ba));
	#endif
	return cachedColor.a;
}
vec3 getColor() {
	return cachedColor.rgb;
}
vec4 getRotation() {
	vec2 rotXY = unpackHalf2x16(cachedTransformA.a);
	vec2 rotZscaleX = unpackHalf2x16(cachedTransformB.x);
	vec3 rotXYZ = vec3(rotXY, rotZscaleX.x);
	return vec4(rotXYZ, sqrt(max(0.0, 1.0 - dot(rotXYZ, rotXYZ)))).wxyz;
}
vec3 getScale() {
	vec2 rotZscaleX = unpackHalf2x16(cachedTransformB.x);
	vec2 scaleYZ = unpackHalf2x16(cachedTransformB.y);
	return vec3(rotZscaleX.y, scaleYZ);
}
`;var Ox=`
void writeSplat(vec3 center, vec4 rotation, vec3 scale, vec4 color) {
	#ifdef GSPLAT_COLOR_UINT
		uint packed_rg = packHalf2x16(color.rg);
		uint packed_ba = packHalf2x16(color.ba);
		writeDataColor(uvec4(
			packed_rg & 0xFFFFu,
			packed_rg >> 16u,
			packed_ba & 0xFFFFu,
			packed_ba >> 16u
		));
	#else
		writeDataColor(color);
	#endif
	#ifndef GSPLAT_COLOR_ONLY
		writeDataTransformA(uvec4(floatBitsToUint(center.x), floatBitsToUint(center.y), floatBitsToUint(center.z), packHalf2x16(rotation.xy)));
		writeDataTransformB(uvec4(packHalf2x16(vec2(rotation.z, scale.x)), packHalf2x16(scale.yz), 0u, 0u));
	#endif
}
`;var Mf=class{_material=new st;_format;_device;_dataFormat=Ba;constructor(e){this._device=e,this._currentRenderer=this._resolveRenderer(this._renderer),this._format=this._createFormat(Ba),this._varyings=new bd(e),this._material.setParameter("alphaClip",.3),this._material.setParameter("alphaClipForward",1/255),this._material.setParameter("minPixelSize",2),this._material.setParameter("minContribution",3),this._material.setParameter("foveationStrength",0),this._material.setParameter("foveationCenter",.3)}_createFormat(e){let t;if(e===Ba)t=new Gs(this._device,[{name:"dataColor",format:xt},{name:"dataTransformA",format:Je},{name:"dataTransformB",format:xt}],{readGLSL:Lx,readWGSL:""}),t.setWriteCode(bx,"");else{let s=this._device.getRenderableHdrFormat([ge])||_t;t=new Gs(this._device,[{name:"dataColor",format:s},{name:"dataTransformA",format:Je},{name:"dataTransformB",format:Hi}],{readGLSL:Fx,readWGSL:""}),t.setWriteCode(Ox,"")}return t.allowStreamRemoval=!0,t.dataFormat=e,t}radialSorting=!1;stochastic=!1;dither=Oa;_renderer=eh;_currentRenderer=th;_resolveRenderer(e){return e===eh?this._device.isWebGPU?cn:th:e===cn&&!this._device.isWebGPU?th:e}set renderer(e){e===Wg&&(e=eh),this._renderer!==e&&(this._renderer=e,this._currentRenderer=this._resolveRenderer(e))}get renderer(){return this._renderer}get currentRenderer(){return this._currentRenderer}dirty=!1;_debug=Ua;set debug(e){if(e!==Yg&&this._debug!==e){let t=this._debug;this._debug=e,(e===Pi||t===Pi)&&(this.dirty=!0)}}get debug(){return this._debug}set colorizeLod(e){this.debug=e?Pi:Ua}get colorizeLod(){return this._debug===Pi}set debugAabbs(e){this.debug=e?hm:Ua}get debugAabbs(){return this._debug===hm}set debugNodeAabbs(e){this.debug=e?dm:Ua}get debugNodeAabbs(){return this._debug===dm}_enableIds=!1;set enableIds(e){e&&!this._enableIds?(this._enableIds=!0,this._format.getStream("pcId")||this._format.addExtraStreams([{name:"pcId",format:xt}])):!e&&this._enableIds&&(this._enableIds=!1,this._format.removeExtraStreams(["pcId"]))}get enableIds(){return this._enableIds}lodUpdateDistance=1;lodUpdateAngle=90;_lodBehindPenalty=1.5;set lodBehindPenalty(e){this._lodBehindPenalty!==e&&(this._lodBehindPenalty=e,this.dirty=!0)}get lodBehindPenalty(){return this._lodBehindPenalty}_lodDistanceShrink=.75;set lodDistanceShrink(e){e=Math.min(Math.max(e,0),1),this._lodDistanceShrink!==e&&(this._lodDistanceShrink=e,this.dirty=!0)}get lodDistanceShrink(){return this._lodDistanceShrink}set lodRangeMin(e){}get lodRangeMin(){return 0}set lodRangeMax(e){}get lodRangeMax(){return 99}_lodUnderfillLimit=0;set lodUnderfillLimit(e){this._lodUnderfillLimit!==e&&(this._lodUnderfillLimit=e,this.dirty=!0)}get lodUnderfillLimit(){return this._lodUnderfillLimit}_splatBudget=ux;set splatBudget(e){this._splatBudget!==e&&(this._splatBudget=e,this.dirty=!0)}get splatBudget(){return this._splatBudget}_splatBudgetMode=cm;set splatBudgetMode(e){e!==cm&&e!==sh||this._splatBudgetMode!==e&&(this._splatBudgetMode=e,this.dirty=!0)}get splatBudgetMode(){return this._splatBudgetMode}set lodMode(e){}get lodMode(){return Xg}_colorRamp=null;set colorRamp(e){this._colorRamp!==e&&(this._colorRamp=e,this.dirty=!0)}get colorRamp(){return this._colorRamp}colorRampIntensity=1;useFog=!0;useTonemap=!0;set colorizeColorUpdate(e){this.debug=e?hn:Ua}get colorizeColorUpdate(){return this._debug===hn}colorUpdateAngle=10;set colorUpdateDistance(e){}get colorUpdateDistance(){return 0}set colorUpdateDistanceLodScale(e){}get colorUpdateDistanceLodScale(){return 0}set colorUpdateAngleLodScale(e){}get colorUpdateAngleLodScale(){return 0}set alphaClip(e){this._material.setParameter("alphaClip",e),this._material.update()}get alphaClip(){return this._material.getParameter("alphaClip")?.data??.3}set alphaClipForward(e){this._material.setParameter("alphaClipForward",e),this._material.update()}get alphaClipForward(){return this._material.getParameter("alphaClipForward")?.data??1/255}set minPixelSize(e){this._material.setParameter("minPixelSize",e),this._material.update()}get minPixelSize(){return this._material.getParameter("minPixelSize")?.data??2}set minContribution(e){this._material.setParameter("minContribution",e),this._material.update()}get minContribution(){return this._material.getParameter("minContribution")?.data??3}set foveationStrength(e){this._material.setParameter("foveationStrength",e),this._material.update()}get foveationStrength(){return this._material.getParameter("foveationStrength")?.data??0}set foveationCenter(e){this._material.setParameter("foveationCenter",e),this._material.update()}get foveationCenter(){return this._material.getParameter("foveationCenter")?.data??.3}set antiAlias(e){this._material.setDefine("GSPLAT_AA",e),this._material.update()}get antiAlias(){return!!this._material.getDefine("GSPLAT_AA")}set twoDimensional(e){this._material.setDefine("GSPLAT_2DGS",e),this._material.update()}get twoDimensional(){return!!this._material.getDefine("GSPLAT_2DGS")}_fisheye=0;set fisheye(e){if(this._fisheye!==e){let t=this._fisheye>0;this._fisheye=e;let s=e>0;t!==s&&(this._material.setDefine("GSPLAT_FISHEYE",s),this._material.update())}}get fisheye(){return this._fisheye}cooldownTicks=100;sceneDepthWrite=!1;set dataFormat(e){if(this._dataFormat!==e){this._dataFormat=e;let t=this._format.extraStreams.map(s=>({name:s.name,format:s.format,storage:s.storage}));this._format=this._createFormat(e),t.length>0&&this._format.addExtraStreams(t),this.dirty=!0}}get dataFormat(){return this._dataFormat}get material(){return this._material}get format(){return this._format}_varyings;_appliedVaryingsVersion=0;get varyings(){return this._varyings}applySettings(e){this.radialSorting=e.gsplatRadialSorting??this.radialSorting,this.lodUpdateDistance=e.gsplatLodUpdateDistance??this.lodUpdateDistance,this.lodUpdateAngle=e.gsplatLodUpdateAngle??this.lodUpdateAngle,this.lodBehindPenalty=e.gsplatLodBehindPenalty??this.lodBehindPenalty,this.lodUnderfillLimit=e.gsplatLodUnderfillLimit??this.lodUnderfillLimit,this.splatBudget=e.gsplatSplatBudget??this.splatBudget,this.splatBudgetMode=e.gsplatSplatBudgetMode??this.splatBudgetMode,this.alphaClip=e.gsplatAlphaClip??this.alphaClip,this.alphaClipForward=e.gsplatAlphaClipForward??this.alphaClipForward,this.minPixelSize=e.gsplatMinPixelSize??this.minPixelSize,this.minContribution=e.gsplatMinContribution??this.minContribution,this.foveationStrength=e.gsplatFoveationStrength??this.foveationStrength,this.foveationCenter=e.gsplatFoveationCenter??this.foveationCenter,this.antiAlias=e.gsplatAntiAlias??this.antiAlias,this.useFog=e.gsplatUseFog??this.useFog,this.useTonemap=e.gsplatUseTonemap??this.useTonemap,this.colorUpdateAngle=e.gsplatColorUpdateAngle??this.colorUpdateAngle,this.cooldownTicks=e.gsplatCooldownTicks??this.cooldownTicks,this.dataFormat=e.gsplatDataFormat??this.dataFormat,this.enableIds=e.gsplatEnableIds??this.enableIds}frameEnd(){this.dirty=!1}frameUpdate(){this._appliedVaryingsVersion!==this._varyings.version&&(this._appliedVaryingsVersion=this._varyings.version,this._varyings.apply(this._material))}};var Lf=class extends lo{_layers=[xa];_instance=null;_placement=null;_id=nh.get();_materialTmp=null;_lodBaseDistance=5;_lodMultiplier=3;_lodRangeMin=0;_lodRangeMax=99;_customAabb=null;_assetReference;_resource=null;_evtLayersChanged=null;_evtLayerAdded=null;_evtLayerRemoved=null;_castShadows=!1;_unified=!0;_parameters=new Map;_workBufferUpdate=Qc;_workBufferModifier=null;constructor(e,t){super(e,t),this._assetReference=new ef("asset",this,e.app.assets,{add:this._onGSplatAssetAdded,load:this._onGSplatAssetLoad,remove:this._onGSplatAssetRemove,unload:this._onGSplatAssetUnload},this),t.on("remove",this.onRemoveChild,this),t.on("removehierarchy",this.onRemoveChild,this),t.on("insert",this.onInsertChild,this),t.on("inserthierarchy",this.onInsertChild,this)}set customAabb(e){this._customAabb=e,this._instance?.meshInstance?.setCustomAabb(this._customAabb),this._placement&&(this._placement.aabb=this._customAabb)}get customAabb(){return this._customAabb??this._placement?.aabb??this.resource?.aabb??null}set instance(e){if(!this.unified&&(this.destroyInstance(),this._instance=e,this._instance)){let t=this._instance.meshInstance;t.node||(t.node=this.entity),t.castShadow=this._castShadows,t.setCustomAabb(this._customAabb),this.enabled&&this.entity.enabled&&this.addToLayers()}}get instance(){return this.unified,this._instance}set material(e){this.unified||(this._instance?this._instance.material=e:this._materialTmp=e)}get material(){return this.unified?null:this._instance?.material??this._materialTmp??null}set castShadows(e){if(this._castShadows!==e){let t=this.layers,s=this.system.app.scene;if(this._placement)if(e)for(let i=0;i<t.length;i++)s.layers.getLayerById(t[i])?.addGSplatShadowCaster(this._placement);else for(let i=0;i<t.length;i++)s.layers.getLayerById(t[i])?.removeGSplatShadowCaster(this._placement);let r=this._instance?.meshInstance;if(r){if(this._castShadows&&!e)for(let i=0;i<t.length;i++)s.layers.getLayerById(this.layers[i])?.removeShadowCasters([r]);if(r.castShadow=e,!this._castShadows&&e)for(let i=0;i<t.length;i++)s.layers.getLayerById(t[i])?.addShadowCasters([r])}this._castShadows=e}}get castShadows(){return this._castShadows}set lodFalloff(e){}get lodFalloff(){return 1}set lodBaseDistance(e){this._lodBaseDistance=Math.max(.1,e),this._placement&&(this._placement.lodBaseDistance=this._lodBaseDistance)}get lodBaseDistance(){return this._lodBaseDistance}set lodMultiplier(e){this._lodMultiplier=Math.max(1.2,e),this._placement&&(this._placement.lodMultiplier=this._lodMultiplier)}get lodMultiplier(){return this._lodMultiplier}set lodRangeMin(e){this._lodRangeMin=e,this._placement&&(this._placement.lodRangeMin=e)}get lodRangeMin(){return this._lodRangeMin}set lodRangeMax(e){this._lodRangeMax=e,this._placement&&(this._placement.lodRangeMax=e)}get lodRangeMax(){return this._lodRangeMax}set lodDistances(e){}get lodDistances(){return[]}set splatBudget(e){}get splatBudget(){return 0}set unified(e){this._unified!==e&&(this._unified=e,this._onGSplatAssetAdded())}get unified(){return this._unified}get id(){return this._id}set workBufferUpdate(e){this._workBufferUpdate=e,this._placement&&(this._placement.workBufferUpdate=e)}get workBufferUpdate(){return this._workBufferUpdate}setWorkBufferModifier(e){if(e){let s=(this.system.app.graphicsDevice.isWebGPU?e.wgsl:e.glsl)??null;this._workBufferModifier=s?{code:s,hash:$e(s)}:null}else this._workBufferModifier=null;this._placement&&(this._placement.workBufferModifier=this._workBufferModifier)}set layers(e){this.removeFromLayers(),this._layers.length=0;for(let t=0;t<e.length;t++)this._layers[t]=e[t];!this.enabled||!this.entity.enabled||this.addToLayers()}get layers(){return this._layers}set asset(e){let t=e instanceof is?e.id:e;this._assetReference.id!==t&&(this._assetReference.asset&&this._assetReference.asset.resource&&this._onGSplatAssetRemove(),this._assetReference.id=t,this._assetReference.asset&&this._onGSplatAssetAdded())}get asset(){return this._assetReference.id}set resource(e){this._resource!==e&&((this._resource||this._assetReference.asset?.resource)&&this._onGSplatAssetRemove(),e&&this._assetReference.id&&(this._assetReference.id=null),this._resource=e,this._resource&&this.enabled&&this.entity.enabled&&this._onGSplatAssetLoad())}get resource(){return this._resource??this._assetReference.asset?.resource??null}destroyInstance(){this._placement&&(this.removeFromLayers(),this._placement.destroy(),this._placement=null),this._instance&&(this.removeFromLayers(),this._instance?.destroy(),this._instance=null)}addToLayers(){if(this._placement){let t=this.system.app.scene.layers;for(let s=0;s<this._layers.length;s++){let r=t.getLayerById(this._layers[s]);r&&(r.addGSplatPlacement(this._placement),this._castShadows&&r.addGSplatShadowCaster(this._placement))}return}let e=this._instance?.meshInstance;if(e){let t=this.system.app.scene.layers;for(let s=0;s<this._layers.length;s++)t.getLayerById(this._layers[s])?.addMeshInstances([e])}}removeFromLayers(){if(this._placement){let t=this.system.app.scene.layers;for(let s=0;s<this._layers.length;s++){let r=t.getLayerById(this._layers[s]);r&&(r.removeGSplatPlacement(this._placement),r.removeGSplatShadowCaster(this._placement))}return}let e=this._instance?.meshInstance;if(e){let t=this.system.app.scene.layers;for(let s=0;s<this._layers.length;s++)t.getLayerById(this._layers[s])?.removeMeshInstances([e])}}onRemoveChild(){this.removeFromLayers()}onInsertChild(){this.enabled&&this.entity.enabled&&(this._instance||this._placement)&&this.addToLayers()}onBeforeRemove(){this.enabled&&this.entity.enabled&&this.onDisable(),this.destroyInstance(),this.asset=null,this._assetReference.id=null,this.entity.off("remove",this.onRemoveChild,this),this.entity.off("removehierarchy",this.onRemoveChild,this),this.entity.off("insert",this.onInsertChild,this),this.entity.off("inserthierarchy",this.onInsertChild,this)}onLayersChanged(e,t){this.addToLayers(),this._evtLayerAdded?.off(),this._evtLayerAdded=t.on("add",this.onLayerAdded,this),this._evtLayerRemoved?.off(),this._evtLayerRemoved=t.on("remove",this.onLayerRemoved,this)}onLayerAdded(e){this.layers.indexOf(e.id)<0||this.unified||this._instance&&e.addMeshInstances(this._instance.meshInstance)}onLayerRemoved(e){this.layers.indexOf(e.id)<0||this.unified||this._instance&&e.removeMeshInstances(this._instance.meshInstance)}onEnable(){let e=this.system.app.scene,t=e.layers;this._evtLayersChanged=e.on("set:layers",this.onLayersChanged,this),t&&(this._evtLayerAdded=t.on("add",this.onLayerAdded,this),this._evtLayerRemoved=t.on("remove",this.onLayerRemoved,this)),this._instance||this._placement?this.addToLayers():this.asset?this._onGSplatAssetAdded():this._resource&&this._onGSplatAssetLoad()}onDisable(){let t=this.system.app.scene.layers;this._evtLayersChanged?.off(),this._evtLayersChanged=null,t&&(this._evtLayerAdded?.off(),this._evtLayerAdded=null,this._evtLayerRemoved?.off(),this._evtLayerRemoved=null),this.removeFromLayers()}hide(){this._instance&&(this._instance.meshInstance.visible=!1)}show(){this._instance&&(this._instance.meshInstance.visible=!0)}setParameter(e,t){let s=this.system.app.graphicsDevice.scope.resolve(e);this._parameters.set(e,{scopeId:s,data:t}),this._placement&&this._placement.markDirty()}getParameter(e){return this._parameters.get(e)?.data}deleteParameter(e){this._parameters.delete(e),this._placement&&this._placement.markDirty()}getInstanceTexture(e){return this._placement?this._placement.getInstanceTexture(e,this.system.app.graphicsDevice)??null:null}_onGSplatAssetAdded(){this._assetReference.asset&&(this._assetReference.asset.resource?this._onGSplatAssetLoad():this.enabled&&this.entity.enabled&&this.system.app.assets.load(this._assetReference.asset))}_onGSplatAssetLoad(){this.destroyInstance();let e=this._resource??this._assetReference.asset?.resource;e&&(this.unified?(this._placement=null,this._placement=new Fi(e,this.entity,0,this._parameters,null,this._id),this._placement.lodBaseDistance=this._lodBaseDistance,this._placement.lodMultiplier=this._lodMultiplier,this._placement.lodRangeMin=this._lodRangeMin,this._placement.lodRangeMax=this._lodRangeMax,this._placement.workBufferUpdate=this._workBufferUpdate,this._placement.workBufferModifier=this._workBufferModifier,this.enabled&&this.entity.enabled&&this.addToLayers()):(this.instance=new Md(e,{material:this._materialTmp,scene:this.system.app.scene}),this._materialTmp=null))}_onGSplatAssetUnload(){this.destroyInstance()}_onGSplatAssetRemove(){this._onGSplatAssetUnload()}};var Nx=`
uniform mat4 matrix_model;
uniform mat4 matrix_view;
#ifndef GSPLAT_CENTER_NOPROJ
	uniform vec4 camera_params;
	uniform mat4 matrix_projection;
	#ifdef GSPLAT_FISHEYE
		uniform float fisheye_k;
		uniform float fisheye_inv_k;
		uniform float fisheye_projMat00;
		uniform float fisheye_projMat11;
		uniform float projectionFlipY;
	#endif
#endif
bool initCenter(vec3 modelCenter, inout SplatCenter center) {
	mat4 modelView = matrix_view * matrix_model;
	vec4 centerView = modelView * vec4(modelCenter, 1.0);
	#ifndef GSPLAT_CENTER_NOPROJ
		#ifdef GSPLAT_FISHEYE
			vec3 v = centerView.xyz;
			float r_xy = length(v.xy);
			float neg_z = -v.z;
			float theta = atan(r_xy, neg_z);
			float maxTheta = min(fisheye_k * 1.5707963, 3.13);
			if (theta > maxTheta - 0.01 || dot(v, v) < 0.0001) {
				return false;
			}
			float tk = theta * fisheye_inv_k;
			float sin_tk = sin(tk);
			float cos_tk = cos(tk);
			float g_theta = fisheye_k * sin_tk / cos_tk;
			float fisheye_s = (r_xy > 1e-4) ? g_theta / r_xy : (neg_z > 0.0 ? 1.0 / neg_z : 0.0);
			float fisheyeProjMat11 = fisheye_projMat11 * projectionFlipY;
			vec2 ndc = vec2(fisheye_projMat00 * fisheye_s * v.x, fisheyeProjMat11 * fisheye_s * v.y);
			float near = camera_params.z;
			float far = camera_params.y;
			float linearDepth = neg_z;
			#if WEBGPU
				float depthNdc = clamp((linearDepth - near) / (far - near), 0.0, 1.0);
			#else
				float depthNdc = clamp(2.0 * (linearDepth - near) / (far - near) - 1.0, -1.0, 1.0);
			#endif
			center.proj = vec4(ndc, depthNdc, 1.0);
			center.projMat00 = fisheye_projMat00;
			center.projMat11 = fisheyeProjMat11;
			center.fisheyeSinTK = sin_tk;
			center.fisheyeCosTK = cos_tk;
			center.fisheyeRxy = r_xy;
		#else
			if (camera_params.w != 1.0 && centerView.z > 0.0) {
				return false;
			}
			vec4 centerProj = matrix_projection * centerView;
			#if WEBGPU
				centerProj.z = clamp(centerProj.z, 0, abs(centerProj.w));
			#else
				centerProj.z = clamp(centerProj.z, -abs(centerProj.w), abs(centerProj.w));
			#endif
			center.proj = centerProj;
			center.projMat00 = matrix_projection[0][0];
			center.projMat11 = matrix_projection[1][1];
		#endif
	#endif
	center.view = centerView.xyz / centerView.w;
	center.modelView = modelView;
	return true;
}
`;var Bx=`
#include "gsplatHelpersVS"
#include "gsplatFormatVS"
#include "gsplatStructsVS"
#include "gsplatDeclarationsVS"
#include "gsplatModifyVS"
#include "gsplatEvalSHVS"
#include "gsplatQuatToMat3VS"
#include "gsplatReadVS"
#include "gsplatSourceVS"
#include "gsplatCenterVS"
#include "gsplatCornerVS"
#include "gsplatOutputVS"
#if defined(SHADOW_PASS) || defined(PICK_PASS) || defined(PREPASS_PASS)
uniform float alphaClip;
#else
uniform float alphaClipForward;
#endif
void clipCorner(inout SplatCorner corner, float alpha) {
	#if defined(SHADOW_PASS) || defined(PICK_PASS) || defined(PREPASS_PASS)
		float alphaClipValue = alphaClip;
	#else
		float alphaClipValue = alphaClipForward;
	#endif
	float clip = min(1.0, sqrt(max(0.0, log(alpha / alphaClipValue))) * 0.5);
	corner.offset *= clip;
	corner.uv *= clip;
}
`;var Ux=`
struct Splat {
	uint index;
	ivec2 uv;
};
Splat splat;
void setSplat(uint idx) {
	splat.index = idx;
	splat.uv = ivec2(idx % splatTextureSize, idx / splatTextureSize);
}
`;var kx=`
	#if SH_BANDS == 1
		#define SH_COEFFS 3
	#elif SH_BANDS == 2
		#define SH_COEFFS 8
	#elif SH_BANDS == 3
		#define SH_COEFFS 15
	#else
		#define SH_COEFFS 0
	#endif
	#if SH_BANDS > 0
	const float SH_C1 = 0.4886025119029199f;
	#if SH_BANDS > 1
		const float SH_C2_0 = 1.0925484305920792f;
		const float SH_C2_1 = -1.0925484305920792f;
		const float SH_C2_2 = 0.31539156525252005f;
		const float SH_C2_3 = -1.0925484305920792f;
		const float SH_C2_4 = 0.5462742152960396f;
	#endif
	#if SH_BANDS > 2
		const float SH_C3_0 = -0.5900435899266435f;
		const float SH_C3_1 = 2.890611442640554f;
		const float SH_C3_2 = -0.4570457994644658f;
		const float SH_C3_3 = 0.3731763325901154f;
		const float SH_C3_4 = -0.4570457994644658f;
		const float SH_C3_5 = 1.445305721320277f;
		const float SH_C3_6 = -0.5900435899266435f;
	#endif
	vec3 evalSH(in vec3 sh[SH_COEFFS], in vec3 dir) {
		float x = dir.x;
		float y = dir.y;
		float z = dir.z;
		vec3 result = SH_C1 * (-sh[0] * y + sh[1] * z - sh[2] * x);
		#if SH_BANDS > 1
			float xx = x * x;
			float yy = y * y;
			float zz = z * z;
			float xy = x * y;
			float yz = y * z;
			float xz = x * z;
			result +=
				sh[3] * (SH_C2_0 * xy) +
				sh[4] * (SH_C2_1 * yz) +
				sh[5] * (SH_C2_2 * (2.0 * zz - xx - yy)) +
				sh[6] * (SH_C2_3 * xz) +
				sh[7] * (SH_C2_4 * (xx - yy));
		#endif
		#if SH_BANDS > 2
			result +=
				sh[8]  * (SH_C3_0 * y * (3.0 * xx - yy)) +
				sh[9]  * (SH_C3_1 * xy * z) +
				sh[10] * (SH_C3_2 * y * (4.0 * zz - xx - yy)) +
				sh[11] * (SH_C3_3 * z * (2.0 * zz - 3.0 * xx - 3.0 * yy)) +
				sh[12] * (SH_C3_4 * x * (4.0 * zz - xx - yy)) +
				sh[13] * (SH_C3_5 * z * (xx - yy)) +
				sh[14] * (SH_C3_6 * x * (xx - 3.0 * yy));
		#endif
		return result;
	}
	#endif
`;var Gx=`
void gsplatMakeSpherical(inout vec3 scale, float size) {
	scale = vec3(size);
}
float gsplatGetSizeFromScale(vec3 scale) {
	return sqrt((scale.x * scale.x + scale.y * scale.y + scale.z * scale.z) / 3.0);
}
`;var Vx=`
void modifySplatCenter(inout vec3 center) {
}
void modifySplatRotationScale(vec3 originalCenter, vec3 modifiedCenter, inout vec4 rotation, inout vec3 scale) {
}
void modifySplatColor(vec3 center, inout vec4 color) {
}
`;var zx=`
void modifySplatColor(vec2 gaussianUV, inout vec4 color) {
}
`;var Hx=`
#ifdef GSPLAT_WORKBUFFER_GEOMETRY
	uniform highp usampler2D uWorkBufferTransformA;
	uniform highp usampler2D uWorkBufferTransformB;
	uniform mat4 matrix_model_inverse;
	uniform vec3 uCameraPosition;
	ivec2 wbCoord;
	uvec4 wbTransformA;
	void initWorkBufferGeometry(ivec2 coord) {
		wbCoord = coord;
		wbTransformA = texelFetch(uWorkBufferTransformA, coord, 0);
	}
	vec3 workBufferWorldCenter() {
		return vec3(uintBitsToFloat(wbTransformA.x), uintBitsToFloat(wbTransformA.y), uintBitsToFloat(wbTransformA.z));
	}
	vec4 workBufferWorldRotation() {
		#ifdef GSPLAT_WORKBUFFER_COMPACT
			uint data = texelFetch(uWorkBufferTransformB, wbCoord, 0).x;
			vec3 p = vec3(
				float(data & 0x7FFu) / 2047.0 * 2.0 - 1.0,
				float((data >> 11u) & 0x7FFu) / 2047.0 * 2.0 - 1.0,
				float((data >> 22u) & 0x3FFu) / 1023.0 * 2.0 - 1.0
			);
			float d = dot(p, p);
			return vec4(sqrt(max(0.0, 2.0 - d)) * p, 1.0 - d);
		#else
			vec2 rotXY = unpackHalf2x16(wbTransformA.w);
			vec3 r = vec3(rotXY, unpackHalf2x16(texelFetch(uWorkBufferTransformB, wbCoord, 0).x).x);
			return vec4(r, sqrt(max(0.0, 1.0 - dot(r, r))));
		#endif
	}
	vec3 workBufferWorldScale() {
		#ifdef GSPLAT_WORKBUFFER_COMPACT
			uint data = wbTransformA.w;
			float sx = float(data & 0xFFu);
			float sy = float((data >> 8u) & 0xFFu);
			float sz = float((data >> 16u) & 0xFFu);
			const float logRange = 21.0 / 255.0;
			const float logMin = -12.0;
			return vec3(
				sx == 0.0 ? 0.0 : exp(sx * logRange + logMin),
				sy == 0.0 ? 0.0 : exp(sy * logRange + logMin),
				sz == 0.0 ? 0.0 : exp(sz * logRange + logMin)
			);
		#else
			uvec2 b = texelFetch(uWorkBufferTransformB, wbCoord, 0).xy;
			return vec3(unpackHalf2x16(b.x).y, unpackHalf2x16(b.y));
		#endif
	}
	vec3 quatRotateInv(vec4 q, vec3 v) {
		vec3 t = -q.xyz;
		return v + 2.0 * cross(t, cross(t, v) + q.w * v);
	}
	vec3 getCenter() {
		return (matrix_model_inverse * vec4(workBufferWorldCenter(), 1.0)).xyz;
	}
	vec4 getRotation() {
		vec4 worldRotation = workBufferWorldRotation();
		vec4 localRotation = quatMul(vec4(-model_rotation.xyz, model_rotation.w), worldRotation);
		return localRotation.wxyz;
	}
	vec3 getScale() {
		return workBufferWorldScale() / model_scale;
	}
#endif
`;var Wx=`
mat3 quatToMat3(vec4 R) {
	vec4 R2 = R + R;
	float X = R2.x * R.w;
	vec4 Y  = R2.y * R;
	vec4 Z  = R2.z * R;
	float W = R2.w * R.w;
	return mat3(
		1.0 - Z.z - W,
			  Y.z + X,
			  Y.w - Z.x,
			  Y.z - X,
		1.0 - Y.y - W,
			  Z.w + Y.x,
			  Y.w + Z.x,
			  Z.w - Y.x,
		1.0 - Y.y - Z.z
	);
}
vec4 quatMul(vec4 a, vec4 b) {
	return vec4(
		a.w * b.x + a.x * b.w + a.y * b.z - a.z * b.y,
		a.w * b.y - a.x * b.z + a.y * b.w + a.z * b.x,
		a.w * b.z + a.x * b.y - a.y * b.x + a.z * b.w,
		a.w * b.w - a.x * b.x - a.y * b.y - a.z * b.z
	);
}
`;var Xx=`
#include "gsplatSplatVS"
struct SplatSource {
	uint order;
	vec2 cornerUV;
};
struct SplatCenter {
	vec3 view;
	vec4 proj;
	mat4 modelView;
	float projMat00;
	float projMat11;
	vec3 modelCenterOriginal;
	vec3 modelCenterModified;
	#ifdef GSPLAT_FISHEYE
		float fisheyeSinTK;
		float fisheyeCosTK;
		float fisheyeRxy;
	#endif
};
struct SplatCorner {
	vec3 offset;
	vec2 uv;
	#if GSPLAT_AA
		float aaFactor;
	#endif
	vec2 v;
	float dlen;
};
`;var Yx=`
uniform vec4 viewport_size;
uniform float minPixelSize;
void computeCovariance(vec4 rotation, vec3 scale, out vec3 covA, out vec3 covB) {
	mat3 rot = quatToMat3(rotation);
	mat3 M = transpose(mat3(
		scale.x * rot[0],
		scale.y * rot[1],
		scale.z * rot[2]
	));
	covA = vec3(dot(M[0], M[0]), dot(M[0], M[1]), dot(M[0], M[2]));
	covB = vec3(dot(M[1], M[1]), dot(M[1], M[2]), dot(M[2], M[2]));
}
bool initCornerCov(SplatSource source, SplatCenter center, out SplatCorner corner, vec3 covA, vec3 covB) {
	mat3 Vrk = mat3(
		covA.x, covA.y, covA.z, 
		covA.y, covB.x, covB.y,
		covA.z, covB.y, covB.z
	);
	vec3 v = center.view.xyz;
	#ifdef GSPLAT_FISHEYE
		float focal = viewport_size.x * center.projMat00;
		float r_sq = max(center.fisheyeRxy * center.fisheyeRxy, 1e-8);
		float d2 = dot(v, v);
		float neg_z = -v.z;
		float g_prime = 1.0 / (center.fisheyeCosTK * center.fisheyeCosTK);
		float g_theta = fisheye_k * center.fisheyeSinTK / center.fisheyeCosTK;
		float sv = (center.fisheyeRxy > 1e-4) ? g_theta / center.fisheyeRxy : (neg_z > 0.0 ? 1.0 / neg_z : 0.0);
		float K = (center.fisheyeRxy > 1e-4) ? (g_prime * neg_z / d2 - sv) / r_sq : 0.0;
		mat3 J = mat3(
			focal * (sv + K * v.x * v.x),  focal * K * v.x * v.y,		 focal * g_prime * v.x / d2,
			focal * K * v.x * v.y,		focal * (sv + K * v.y * v.y),	focal * g_prime * v.y / d2,
			0.0,						   0.0,							0.0
		);
		J[1] *= sign(center.projMat11);
	#else
		vec2 focal = viewport_size.xy * vec2(center.projMat00, center.projMat11);
		vec3 vp = camera_params.w == 1.0 ? vec3(0.0, 0.0, 1.0) : v;
		vec2 J1 = focal / vp.z;
		vec2 J2 = -J1 / vp.z * vp.xy;
		mat3 J = mat3(
			J1.x, 0.0, J2.x,
			0.0, J1.y, J2.y,
			0.0, 0.0, 0.0
		);
	#endif
	mat3 W = transpose(mat3(center.modelView));
	mat3 T = W * J;
	mat3 cov = transpose(T) * Vrk * T;
	#if GSPLAT_AA
		float detOrig = cov[0][0] * cov[1][1] - cov[0][1] * cov[0][1];
		float detBlur = (cov[0][0] + 0.3) * (cov[1][1] + 0.3) - cov[0][1] * cov[0][1];
		corner.aaFactor = sqrt(max(detOrig / detBlur, 0.0));
	#endif
	float diagonal1 = cov[0][0] + 0.3;
	float offDiagonal = cov[0][1];
	float diagonal2 = cov[1][1] + 0.3;
	float mid = 0.5 * (diagonal1 + diagonal2);
	float radius = length(vec2((diagonal1 - diagonal2) / 2.0, offDiagonal));
	float lambda1 = mid + radius;
	float lambda2 = max(mid - radius, 0.1);
	float vmin = min(1024.0, min(viewport_size.x, viewport_size.y));
	float l1 = 2.0 * min(sqrt(2.0 * lambda1), vmin);
	float l2 = 2.0 * min(sqrt(2.0 * lambda2), vmin);
	if (max(l1, l2) < minPixelSize) {
		return false;
	}
	vec2 c = center.proj.ww * viewport_size.zw;
	if (any(greaterThan(abs(center.proj.xy) - vec2(max(l1, l2)) * c, center.proj.ww))) {
		return false;
	}
	vec2 diagonalVector = normalize(vec2(offDiagonal, lambda1 - diagonal1));
	vec2 v1 = l1 * diagonalVector;
	vec2 v2 = l2 * vec2(diagonalVector.y, -diagonalVector.x);
	corner.offset = vec3((source.cornerUV.x * v1 + source.cornerUV.y * v2) * c, 0.0);
	corner.uv = source.cornerUV;
	return true;
}
#if GSPLAT_2DGS
void initCorner2DGS(SplatSource source, vec4 rotation, vec3 scale, out SplatCorner corner) {
	vec2 localPos = source.cornerUV * vec2(scale.x, scale.y) * 3.0;
	vec3 v = vec3(localPos, 0.0);
	vec3 t = 2.0 * cross(rotation.xyz, v);
	corner.offset = v + rotation.w * t + cross(rotation.xyz, t);
	corner.uv = source.cornerUV;
}
#endif
bool initCorner(SplatSource source, SplatCenter center, out SplatCorner corner) {
	vec4 rotation = getRotation().yzwx;
	vec3 scale = getScale();
	modifySplatRotationScale(center.modelCenterOriginal, center.modelCenterModified, rotation, scale);
	#if GSPLAT_2DGS
		initCorner2DGS(source, rotation, scale, corner);
		return true;
	#else
		vec3 covA, covB;
		computeCovariance(rotation.wxyz, scale, covA, covB);
		return initCornerCov(source, center, corner, covA, covB);
	#endif
}
`;var jx=`
#include "tonemappingPS"
#include "decodePS"
#include "gammaPS"
#include "fogPS"
#if FOG != NONE && !defined(GSPLAT_NO_FOG)
	#define GSPLAT_FOG
#endif
#if TONEMAP != NONE && !defined(GSPLAT_NO_TONEMAP)
	#define GSPLAT_TONEMAP
#endif
vec3 prepareOutputFromGamma(vec3 gammaColor, float depth) {
	vec3 color = gammaColor;
	#if defined(GSPLAT_TONEMAP) || GAMMA == NONE || defined(GSPLAT_FOG)
		color = decodeGamma(color);
	#endif
	#ifdef GSPLAT_FOG
		color = addFog(color, depth);
	#endif
	#ifdef GSPLAT_TONEMAP
		color = toneMap(color);
	#endif
	#if defined(GSPLAT_TONEMAP) || (GAMMA != NONE && defined(GSPLAT_FOG))
		color = gammaCorrectOutput(color);
	#endif
	return color;
}
`;var qx=`
#ifndef DITHER_NONE
	#include "opacityDitherPS"
	flat varying float id;
#endif
#if defined(SHADOW_PASS) || defined(PICK_PASS) || defined(PREPASS_PASS)
	uniform float alphaClip;
#endif
#ifdef PREPASS_PASS
	flat varying float vLinearDepth;
	#include "floatAsUintPS"
#endif
#if defined(SCENE_TEXTURE_DEPTH) && !defined(PREPASS_PASS)
	flat varying float vLinearDepth;
#endif
#include "sceneTexturesPS"
#if !defined(SHADOW_PASS) && !defined(PICK_PASS) && !defined(PREPASS_PASS)
	uniform float alphaClipForward;
#endif
varying mediump vec2 gaussianUV;
flat varying mediump vec4 gaussianColor;
#if defined(GSPLAT_UNIFIED_ID) && defined(PICK_PASS)
	flat varying uint vPickId;
#endif
#ifdef PICK_PASS
	#include "pickPS"
#endif
#ifdef SHADOW_PASS
	#include "shadowCasterPS"
#endif
#ifdef GSPLAT_USER_VARYINGS
	#include "gsplatUserVaryingsPS"
#endif
#include "gsplatModifyPS"
const float EXP4 = exp(-4.0);
const float INV_EXP4 = 1.0 / (1.0 - EXP4);
float normExp(float x) {
	return (exp(x * -4.0) - EXP4) * INV_EXP4;
}
void main(void) {
	mediump float A = dot(gaussianUV, gaussianUV);
	if (A > 1.0) {
		discard;
	}
	mediump float alpha = normExp(A) * gaussianColor.a;
	#if defined(SHADOW_PASS) || defined(PICK_PASS) || defined(PREPASS_PASS)
		if (alpha < alphaClip) {
			discard;
		}
	#endif
	#ifdef PICK_PASS
		#ifdef GSPLAT_UNIFIED_ID
			pcFragColor0 = encodePickOutput(vPickId);
		#else
			pcFragColor0 = getPickOutput();
		#endif
		#ifdef DEPTH_PICK_PASS
			pcFragColor1 = getPickDepth();
		#endif
	#elif SHADOW_PASS
		gl_FragColor = getShadowOutput();
	#elif PREPASS_PASS
		gl_FragColor = float2vec4(vLinearDepth);
	#else
		if (alpha < alphaClipForward) {
			discard;
		}
		vec4 fragColor = vec4(gaussianColor.xyz, alpha);
		modifySplatColor(gaussianUV, fragColor);
		#ifndef DITHER_NONE
			opacityDither(fragColor.a, id * 0.013);
		#endif
		gl_FragColor = vec4(fragColor.xyz * fragColor.a, fragColor.a);
		#ifdef SCENE_TEXTURE_DEPTH
			#ifdef DITHER_NONE
				writeSceneTextureDepth(vLinearDepth, fragColor.a);
			#else
				writeSceneTextureDepth(vLinearDepth, 1.0);
			#endif
		#endif
	#endif
}
`;var $x=`
attribute vec3 vertex_position;
uniform uint numSplats;
uniform highp usampler2D splatOrder;
bool initSource(out SplatSource source) {
	source.order = uint(gl_InstanceID) * {GSPLAT_INSTANCE_SIZE}u + uint(vertex_position.z);
	if (source.order >= numSplats) {
		return false;
	}
	ivec2 orderUV = ivec2(source.order % splatTextureSize, source.order / splatTextureSize);
	uint splatId = texelFetch(splatOrder, orderUV, 0).r;
	setSplat(splatId);
	source.cornerUV = vertex_position.xy;
	return true;
}
`;var Kx=`
#ifdef GSPLAT_USER_VARYINGS
	#include "gsplatUserVaryingsVS"
#endif
#include "gsplatCommonVS"
varying mediump vec2 gaussianUV;
flat varying mediump vec4 gaussianColor;
#ifndef DITHER_NONE
	flat varying float id;
#endif
mediump vec4 discardVec = vec4(0.0, 0.0, 2.0, 1.0);
#if defined(PREPASS_PASS) || defined(SCENE_TEXTURE_DEPTH)
	flat varying float vLinearDepth;
#endif
#if defined(GSPLAT_UNIFIED_ID) && defined(PICK_PASS)
	flat varying uint vPickId;
#endif
#ifdef GSPLAT_OVERDRAW
	uniform sampler2D colorRamp;
	uniform float colorRampIntensity;
#endif
void main(void) {
	SplatSource source;
	if (!initSource(source)) {
		gl_Position = discardVec;
		return;
	}
	vec3 modelCenter = getCenter();
	SplatCenter center;
	center.modelCenterOriginal = modelCenter;
	
	modifySplatCenter(modelCenter);
	center.modelCenterModified = modelCenter;
	if (!initCenter(modelCenter, center)) {
		gl_Position = discardVec;
		return;
	}
	SplatCorner corner;
	if (!initCorner(source, center, corner)) {
		gl_Position = discardVec;
		return;
	}
	#ifdef GSPLAT_SEPARATE_OPACITY
		float opacity = getOpacity();
		vec4 clr = vec4(getColor(), opacity);
	#else
		vec4 clr = getColor();
	#endif
	#if GSPLAT_AA
		clr.a *= corner.aaFactor;
	#endif
	#if SH_BANDS > 0
		vec3 viewDir = camera_params.w == 1.0 ? vec3(0.0, 0.0, -1.0) : center.view;
		vec3 dir = normalize(viewDir * mat3(center.modelView));
		vec3 sh[SH_COEFFS];
		float scale;
		readSHData(sh, scale);
		clr.xyz += evalSH(sh, dir) * scale;
	#endif
	modifySplatColor(modelCenter, clr);
	#if defined(SHADOW_PASS) || defined(PICK_PASS) || defined(PREPASS_PASS)
		float alphaClipValue = alphaClip;
	#else
		float alphaClipValue = alphaClipForward;
	#endif
	if (clr.w <= alphaClipValue) {
		gl_Position = discardVec;
		return;
	}
	clipCorner(corner, clr.w);
	#if GSPLAT_2DGS
		vec3 modelCorner = center.modelCenterModified + corner.offset;
		gl_Position = matrix_projection * center.modelView * vec4(modelCorner, 1.0);
	#else
		gl_Position = center.proj + vec4(corner.offset.xyz, 0);
	#endif
	gaussianUV = corner.uv;
	#ifdef GSPLAT_OVERDRAW
		float t = clamp(modelCenter.y / 20.0, 0.0, 1.0);
		vec3 rampColor = textureLod(colorRamp, vec2(t, 0.5), 0.0).rgb;
		clr.a *= (1.0 / 32.0) * colorRampIntensity;
		gaussianColor = vec4(rampColor, clr.a);
	#else
		gaussianColor = vec4(prepareOutputFromGamma(max(clr.xyz, 0.0), -center.view.z), clr.w);
	#endif
	#ifndef DITHER_NONE
		id = float(splat.index);
	#endif
	#if defined(PREPASS_PASS) || defined(SCENE_TEXTURE_DEPTH)
		vLinearDepth = -center.view.z;
	#endif
	#if defined(GSPLAT_UNIFIED_ID) && defined(PICK_PASS)
		vPickId = loadPcId().r;
	#endif
}
`;var Zx=`
uint pack8888(vec4 v) {
	uvec4 t = uvec4(v * 255.0) << uvec4(24u, 16u, 8u, 0u);
	return t.x | t.y | t.z | t.w;
}
uint pack101010(vec3 v) {
	uvec3 t = uvec3(v * 1023.0) << uvec3(20u, 10u, 0u);
	return t.x | t.y | t.z;
}
uint pack111110(vec3 v) {
	uvec3 t = uvec3(v * vec3(2047.0, 2047.0, 1023.0)) << uvec3(21u, 10u, 0u);
	return t.x | t.y | t.z;
}
vec4 unpack8888(uint v) {
	return vec4((uvec4(v) >> uvec4(24u, 16u, 8u, 0u)) & 0xffu) / 255.0;
}
vec3 unpack101010(uint v) {
	return vec3((uvec3(v) >> uvec3(20u, 10u, 0u)) & 0x3ffu) / 1023.0;
}
vec3 unpack111110(uint v) {
	return vec3((uvec3(v) >> uvec3(21u, 10u, 0u)) & uvec3(0x7ffu, 0x7ffu, 0x3ffu)) / vec3(2047.0, 2047.0, 1023.0);
}
vec3 resolveCodebook(vec3 s, vec4 codebook[64]) {
	uvec3 idx = uvec3(s * 255.0);
	vec3 v = vec3(
		codebook[idx.x >> 2u][idx.x & 3u],
		codebook[idx.y >> 2u][idx.y & 3u],
		codebook[idx.z >> 2u][idx.z & 3u]
	);
	return (v - codebook[0].x) / (codebook[63].w - codebook[0].x);
}
`;var Qx=`
uniform uint splatTextureSize;
`;var Jx=`
uint tAw;
vec4 tBcached;
vec4 unpackRotation(vec3 data) {
	return vec4(data.xyz, sqrt(max(0.0, 1.0 - dot(data, data))));
}
vec3 getCenter() {
	uvec4 tA = loadTransformA();
	tAw = tA.w;
	tBcached = loadTransformB();
	return uintBitsToFloat(tA.xyz);
}
vec4 getColor() {
	return loadSplatColor();
}
vec4 getRotation() {
	return unpackRotation(vec3(unpackHalf2x16(tAw), tBcached.w)).wxyz;
}
vec3 getScale() {
	return tBcached.xyz;
}
#include "gsplatUncompressedSHVS"
`;var eA=`
#if SH_BANDS > 0
vec3 unpack111011s(uint bits) {
	return vec3((uvec3(bits) >> uvec3(21u, 11u, 0u)) & uvec3(0x7ffu, 0x3ffu, 0x7ffu)) / vec3(2047.0, 1023.0, 2047.0) * 2.0 - 1.0;
}
void fetchScale(in uvec4 t, out float scale, out vec3 a, out vec3 b, out vec3 c) {
	scale = uintBitsToFloat(t.x);
	a = unpack111011s(t.y);
	b = unpack111011s(t.z);
	c = unpack111011s(t.w);
}
void fetch(in uvec4 t, out vec3 a, out vec3 b, out vec3 c, out vec3 d) {
	a = unpack111011s(t.x);
	b = unpack111011s(t.y);
	c = unpack111011s(t.z);
	d = unpack111011s(t.w);
}
void fetch(in uint t, out vec3 a) {
	a = unpack111011s(t);
}
#if SH_BANDS == 1
	void readSHData(out vec3 sh[3], out float scale) {
		fetchScale(loadSplatSH_1to3(), scale, sh[0], sh[1], sh[2]);
	}
#elif SH_BANDS == 2
	void readSHData(out vec3 sh[8], out float scale) {
		fetchScale(loadSplatSH_1to3(), scale, sh[0], sh[1], sh[2]);
		fetch(loadSplatSH_4to7(), sh[3], sh[4], sh[5], sh[6]);
		fetch(loadSplatSH_8to11().x, sh[7]);
	}
#else
	void readSHData(out vec3 sh[15], out float scale) {
		fetchScale(loadSplatSH_1to3(), scale, sh[0], sh[1], sh[2]);
		fetch(loadSplatSH_4to7(), sh[3], sh[4], sh[5], sh[6]);
		fetch(loadSplatSH_8to11(), sh[7], sh[8], sh[9], sh[10]);
		fetch(loadSplatSH_12to15(), sh[11], sh[12], sh[13], sh[14]);
	}
#endif
#endif
`;var tA=`
#include "gsplatPackingPS"
uniform highp sampler2D chunkTexture;
vec4 chunkDataA;
vec4 chunkDataB;
vec4 chunkDataC;
vec4 chunkDataD;
vec4 chunkDataE;
uvec4 packedData;
vec3 unpack111011(uint bits) {
	return vec3(
		float(bits >> 21u) / 2047.0,
		float((bits >> 11u) & 0x3ffu) / 1023.0,
		float(bits & 0x7ffu) / 2047.0
	);
}
const float norm = sqrt(2.0);
vec4 unpackRotation(uint bits) {
	float a = (float((bits >> 20u) & 0x3ffu) / 1023.0 - 0.5) * norm;
	float b = (float((bits >> 10u) & 0x3ffu) / 1023.0 - 0.5) * norm;
	float c = (float(bits & 0x3ffu) / 1023.0 - 0.5) * norm;
	float m = sqrt(1.0 - (a * a + b * b + c * c));
	uint mode = bits >> 30u;
	if (mode == 0u) return vec4(m, a, b, c);
	if (mode == 1u) return vec4(a, m, b, c);
	if (mode == 2u) return vec4(a, b, m, c);
	return vec4(a, b, c, m);
}
vec3 getCenter() {
	uint w = uint(textureSize(chunkTexture, 0).x) / 5u;
	uint chunkId = splat.index / 256u;
	ivec2 chunkUV = ivec2((chunkId % w) * 5u, chunkId / w);
	chunkDataA = texelFetch(chunkTexture, chunkUV, 0);
	chunkDataB = texelFetch(chunkTexture, chunkUV + ivec2(1, 0), 0);
	chunkDataC = texelFetch(chunkTexture, chunkUV + ivec2(2, 0), 0);
	chunkDataD = texelFetch(chunkTexture, chunkUV + ivec2(3, 0), 0);
	chunkDataE = texelFetch(chunkTexture, chunkUV + ivec2(4, 0), 0);
	packedData = loadPackedTexture();
	return mix(chunkDataA.xyz, vec3(chunkDataA.w, chunkDataB.xy), unpack111011(packedData.x));
}
vec4 getColor() {
	vec4 r = unpack8888(packedData.w);
	return vec4(mix(chunkDataD.xyz, vec3(chunkDataD.w, chunkDataE.xy), r.rgb), r.w);
}
vec4 getRotation() {
	return unpackRotation(packedData.y);
}
vec3 getScale() {
	return exp(mix(vec3(chunkDataB.zw, chunkDataC.x), chunkDataC.yzw, unpack111011(packedData.z)));
}
#include "gsplatCompressedSHVS"
`;var sA=`
#if SH_BANDS > 0
vec4 unpack8888s(in uint bits) {
	return vec4((uvec4(bits) >> uvec4(0u, 8u, 16u, 24u)) & 0xffu) * (8.0 / 255.0) - 4.0;
}
void readSHData(out vec3 sh[15], out float scale) {
	uvec4 shData0 = loadShTexture0();
	uvec4 shData1 = loadShTexture1();
	uvec4 shData2 = loadShTexture2();
	vec4 r0 = unpack8888s(shData0.x);
	vec4 r1 = unpack8888s(shData0.y);
	vec4 r2 = unpack8888s(shData0.z);
	vec4 r3 = unpack8888s(shData0.w);
	vec4 g0 = unpack8888s(shData1.x);
	vec4 g1 = unpack8888s(shData1.y);
	vec4 g2 = unpack8888s(shData1.z);
	vec4 g3 = unpack8888s(shData1.w);
	vec4 b0 = unpack8888s(shData2.x);
	vec4 b1 = unpack8888s(shData2.y);
	vec4 b2 = unpack8888s(shData2.z);
	vec4 b3 = unpack8888s(shData2.w);
	sh[0] =  vec3(r0.x, g0.x, b0.x);
	sh[1] =  vec3(r0.y, g0.y, b0.y);
	sh[2] =  vec3(r0.z, g0.z, b0.z);
	sh[3] =  vec3(r0.w, g0.w, b0.w);
	sh[4] =  vec3(r1.x, g1.x, b1.x);
	sh[5] =  vec3(r1.y, g1.y, b1.y);
	sh[6] =  vec3(r1.z, g1.z, b1.z);
	sh[7] =  vec3(r1.w, g1.w, b1.w);
	sh[8] =  vec3(r2.x, g2.x, b2.x);
	sh[9] =  vec3(r2.y, g2.y, b2.y);
	sh[10] = vec3(r2.z, g2.z, b2.z);
	sh[11] = vec3(r2.w, g2.w, b2.w);
	sh[12] = vec3(r3.x, g3.x, b3.x);
	sh[13] = vec3(r3.y, g3.y, b3.y);
	sh[14] = vec3(r3.z, g3.z, b3.z);
	scale = 1.0;
}
#endif
`;var rA=`
uniform vec3 means_mins;
uniform vec3 means_maxs;
#ifndef SOG_V2
	uniform vec3 scales_mins;
	uniform vec3 scales_maxs;
	uniform vec4 sh0_mins;
	uniform vec4 sh0_maxs;
#endif
const float SH_C0 = 0.28209479177387814;
const float norm = sqrt(2.0);
#ifdef SOG_V2
	float lutScales(int b) { return texelFetch(sogCodebook, ivec2(b, 0), 0).r; }
	float lutSh0(int b)	{ return texelFetch(sogCodebook, ivec2(b, 0), 0).g; }
	float lutShN(int b)	{ return texelFetch(sogCodebook, ivec2(b, 0), 0).b; }
#endif
#ifndef GSPLAT_WORKBUFFER_GEOMETRY
vec3 getCenter() {
	vec3 l = texelFetch(means_l, splat.uv, 0).xyz;
	vec3 u = texelFetch(means_u, splat.uv, 0).xyz;
	vec3 n = (l + u * 256.0) / 257.0;
	vec3 v = mix(means_mins, means_maxs, n);
	return sign(v) * (exp(abs(v)) - 1.0);
}
vec4 getRotation() {
	vec4 q = texelFetch(quats, splat.uv, 0);
	uint qmode = uint(q.w * 255.0 + 0.5) - 252u;
	vec3 abc = (q.xyz - 0.5) * norm;
	float d = sqrt(max(0.0, 1.0 - dot(abc, abc)));
	return (qmode == 0u) ? vec4(d, abc) :
		   ((qmode == 1u) ? vec4(abc.x, d, abc.yz) :
		   ((qmode == 2u) ? vec4(abc.xy, d, abc.z) : vec4(abc, d)));
}
vec3 getScale() {
	vec3 s = texelFetch(scales, splat.uv, 0).xyz;
	#ifdef SOG_V2
		ivec3 i = ivec3(s * 255.0 + 0.5);
		vec3 logS = vec3(lutScales(i.x), lutScales(i.y), lutScales(i.z));
	#else
		vec3 logS = mix(scales_mins, scales_maxs, s);
	#endif
	return exp(logS);
}
#endif
vec4 getColor() {
	vec4 c = texelFetch(sh0, splat.uv, 0);
	#ifdef SOG_V2
		ivec3 i = ivec3(c.xyz * 255.0 + 0.5);
		vec3 rgb = vec3(lutSh0(i.x), lutSh0(i.y), lutSh0(i.z));
		float alpha = c.w;
	#else
		vec3 rgb = mix(sh0_mins.xyz, sh0_maxs.xyz, c.xyz);
		float logitAlpha = mix(sh0_mins.w, sh0_maxs.w, c.w);
		float alpha = 1.0 / (1.0 + exp(-logitAlpha));
	#endif
	return vec4(vec3(0.5) + rgb * SH_C0, alpha);
}
#include "gsplatSogSHVS"
`;var iA=`
#if SH_BANDS > 0
	#ifndef SOG_V2
		uniform float shN_mins;
		uniform float shN_maxs;
	#endif
	void readSHData(out vec3 sh[SH_COEFFS], out float scale) {
		vec4 labels = texelFetch(sh_labels, splat.uv, 0);
		int n = int(labels.x * 255.0 + 0.5) + int(labels.y * 255.0 + 0.5) * 256;
		int u = (n % 64) * SH_COEFFS;
		int v = n / 64;
		for (int i = 0; i < SH_COEFFS; i++) {
			vec4 t = texelFetch(sh_centroids, ivec2(u + i, v), 0);
			#ifdef SOG_V2
				ivec3 idx = ivec3(t.xyz * 255.0 + 0.5);
				sh[i] = vec3(lutShN(idx.x), lutShN(idx.y), lutShN(idx.z));
			#else
				sh[i] = mix(vec3(shN_mins), vec3(shN_maxs), t.xyz);
			#endif
		}
		scale = 1.0;
	}
#endif
`;var aA=`
#include "gsplatContainerDeclarationsVS"
vec3 splatCenter;
vec4 splatColor;
vec3 splatScale;
vec4 splatRotation;
`;var oA=`
vec3 getCenter() {
	#include "gsplatContainerUserReadVS"
	return splatCenter;
}
vec4 getRotation() {
	return splatRotation;
}
vec3 getScale() {
	return splatScale;
}
vec4 getColor() {
	return splatColor;
}
`;var nA={gsplatCenterVS:Nx,gsplatCornerVS:Yx,gsplatCommonVS:Bx,gsplatSplatVS:Ux,gsplatEvalSHVS:kx,gsplatHelpersVS:Gx,gsplatModifyVS:Vx,gsplatModifyPS:zx,gsplatWorkBufferGeometryPS:Hx,gsplatQuatToMat3VS:Wx,gsplatStructsVS:Xx,gsplatOutputVS:jx,gsplatPS:qx,gsplatSourceVS:$x,gsplatVS:Kx,gsplatPackingPS:Zx,gsplatFormatVS:Qx,gsplatUncompressedVS:Jx,gsplatUncompressedSHVS:eA,gsplatCompressedVS:tA,gsplatCompressedSHVS:sA,gsplatSogVS:rA,gsplatSogSHVS:iA,gsplatContainerDeclVS:aA,gsplatContainerReadVS:oA,gsplatContainerFloatReadVS:Pd};var lA={gsplatCenterVS:"",gsplatCornerVS:"",gsplatCommonVS:"",gsplatSplatVS:"",gsplatEvalSHVS:"",gsplatHelpersVS:"",gsplatModifyVS:"",gsplatModifyPS:"",gsplatWorkBufferGeometryPS:"",gsplatStructsVS:"",gsplatQuatToMat3VS:"",gsplatOutputVS:"",gsplatPS:"",gsplatSourceVS:"",gsplatVS:"",gsplatHybridVS:"",gsplatPackingPS:"",gsplatFormatVS:"",gsplatUncompressedVS:"",gsplatUncompressedSHVS:"",gsplatCompressedVS:"",gsplatCompressedSHVS:"",gsplatSogVS:"",gsplatSogSHVS:"",gsplatContainerDeclVS:"",gsplatContainerReadVS:"",gsplatContainerFloatReadVS:""};var nI=l=>{switch(l){case li:return e=>Math.max(e/127,-1);case ci:return e=>e/255;case hi:return e=>Math.max(e/32767,-1);case ko:return e=>e/65535;default:return e=>e}},Zp=(l,e,t)=>{let s=nI(t),r=e.length;for(let i=0;i<r;++i)l[i]=s(e[i]);return l},qe=class l{static getNumComponents(e){switch(e){case"SCALAR":return 1;case"VEC2":return 2;case"VEC3":return 3;case"VEC4":return 4;case"MAT2":return 4;case"MAT3":return 9;case"MAT4":return 16;default:return 3}}static getComponentType(e){switch(e){case 5120:return li;case 5121:return ci;case 5122:return hi;case 5123:return ko;case 5124:return pe;case 5125:return Qe;case 5126:return _e;default:return 0}}static getComponentSizeInBytes(e){switch(e){case 5120:return 1;case 5121:return 1;case 5122:return 2;case 5123:return 2;case 5124:return 4;case 5125:return 4;case 5126:return 4;default:return 0}}static getComponentDataType(e){switch(e){case 5120:return Int8Array;case 5121:return Uint8Array;case 5122:return Int16Array;case 5123:return Uint16Array;case 5124:return Int32Array;case 5125:return Uint32Array;case 5126:return Float32Array;default:return null}}static getData(e,t,s=!1){let r=l.getNumComponents(e.type),i=l.getComponentDataType(e.componentType);if(!i)return null;let a;if(e.sparse){let o=e.sparse,n={count:o.count,type:"SCALAR"},c=l.getData(Object.assign(n,o.indices),t,!0),h={count:o.count,type:e.type,componentType:e.componentType},d=l.getData(Object.assign(h,o.values),t,!0);if(e.hasOwnProperty("bufferView")){let f={bufferView:e.bufferView,byteOffset:e.byteOffset,componentType:e.componentType,count:e.count,type:e.type};a=l.getData(f,t,!0).slice()}else a=new i(e.count*r);for(let f=0;f<o.count;++f){let u=c[f];for(let m=0;m<r;++m)a[u*r+m]=d[f*r+m]}}else if(e.hasOwnProperty("bufferView")){let o=t[e.bufferView];if(s&&o.hasOwnProperty("byteStride")){let n=r*i.BYTES_PER_ELEMENT,c=new ArrayBuffer(e.count*n),h=new Uint8Array(c),d=0;for(let f=0;f<e.count;++f){let u=(e.byteOffset||0)+f*o.byteStride;for(let m=0;m<n;++m)h[d++]=o[u++]}a=new i(c)}else a=new i(o.buffer,o.byteOffset+(e.byteOffset||0),e.count*r)}else a=new i(e.count*r);return a}static extractComponent(e,t,s,r){let i=new Float32Array(r);for(let a=0;a<r;a++)i[a]=e[a*t+s];return i}static getDataFloat32(e,t){let s=l.getData(e,t,!0);if(s instanceof Float32Array||!e.normalized)return s;let r=new Float32Array(s.length);return Zp(r,s,l.getComponentType(e.componentType)),r}static getBoundingBox(e){let t=e.min,s=e.max;if(!t||!s)return null;if(e.normalized){let r=l.getComponentType(e.componentType);t=Zp([],t,r),s=Zp([],s,r)}return new J(new y((s[0]+t[0])*.5,(s[1]+t[1])*.5,(s[2]+t[2])*.5),new y((s[0]-t[0])*.5,(s[1]-t[1])*.5,(s[2]-t[2])*.5))}};var Cr="KHR_gaussian_splatting",cA=[3,5,7],lI={1:3,2:8,3:15},hA=l=>!!l?.extensions?.[Cr],cI=(l,e,t)=>{let s=l.extensions[Cr],r=l.attributes,i=e[r.POSITION]?.count??0,a=p=>{let g=e[r[p]];return!g||g.count!==i?null:qe.getDataFloat32(g,t)},o=a("POSITION"),n=a(`${Cr}:ROTATION`),c=a(`${Cr}:SCALE`),h=a(`${Cr}:OPACITY`),d=a(`${Cr}:SH_DEGREE_0_COEF_0`);if(!i||!o||!n||!c||!h||!d)return null;let f=[],u=(p,g)=>{f.push({type:"float",name:p,storage:g,byteSize:4})};u("x",qe.extractComponent(o,3,0,i)),u("y",qe.extractComponent(o,3,1,i)),u("z",qe.extractComponent(o,3,2,i)),u("rot_0",qe.extractComponent(n,4,3,i)),u("rot_1",qe.extractComponent(n,4,0,i)),u("rot_2",qe.extractComponent(n,4,1,i)),u("rot_3",qe.extractComponent(n,4,2,i)),u("scale_0",qe.extractComponent(c,3,0,i)),u("scale_1",qe.extractComponent(c,3,1,i)),u("scale_2",qe.extractComponent(c,3,2,i)),u("opacity",qe.extractComponent(h,1,0,i)),u("f_dc_0",qe.extractComponent(d,3,0,i)),u("f_dc_1",qe.extractComponent(d,3,1,i)),u("f_dc_2",qe.extractComponent(d,3,2,i));let m=0;for(let p=1;p<=3;p++){let g=!0;for(let T=0;T<cA[p-1];T++)if(r[`${Cr}:SH_DEGREE_${p}_COEF_${T}`]===void 0){g=!1;break}if(!g)break;m=p}if(m>0){let p=lI[m],g=new Array(p*3),T=0;for(let S=1;S<=m;S++)for(let x=0;x<cA[S-1];x++){let C=`${Cr}:SH_DEGREE_${S}_COEF_${x}`,E=a(C);if(!E)return null;g[T]=qe.extractComponent(E,3,0,i),g[p+T]=qe.extractComponent(E,3,1,i),g[p*2+T]=qe.extractComponent(E,3,2,i),T++}for(let S=0;S<p*3;S++)u(`f_rest_${S}`,g[S])}let _=new Rd([{name:"vertex",count:i,properties:f}]);return _.activated=!0,_},hI=(l,e,t)=>e.hasOwnProperty("meshes")?e.meshes.map(s=>{let r=null;return s.primitives.forEach(i=>{if(hA(i)){let a=cI(i,e.accessors,t);a&&(a.reorderData(),r||(r=[]),r.push(new Ld(l,a)))}}),r}):[],Qp={name:Cr,resourceName:"gsplats",handlesPrimitive:hA,createResources:hI};var dI=Symbol("glbResourceExtensions");var dA=l=>Reflect.get(l,dI),fA=(l,e)=>{let t=dA(l);return t?(t.set(e.name,e),!0):!1},uA=(l,e)=>{dA(l)?.delete(e)};var Qn=["unified","lodBaseDistance","lodMultiplier","lodRangeMin","lodRangeMax","castShadows","material","asset","resource","layers"],Jn=class extends no{_containerHandler=null;static EVENT_MATERIALCREATED="material:created";static EVENT_FRAMEREADY="frame:ready";static EVENT_FRAMEREQUEST="frame:request";constructor(e){super(e),this.id="gsplat",this.ComponentType=Lf,this.extraDataProperties=["aabbCenter","aabbHalfExtents"];let t=e.loader.getHandler("container");t&&fA(t,Qp)&&(this._containerHandler=t);let s=new Mf(e.graphicsDevice);e.scene.setGsplatParams(s),e.renderer.gsplatDirector=new wf(e.graphicsDevice,e.renderer,e.scene,this,s),Ee.get(e.graphicsDevice,ce).add(nA),Ee.get(e.graphicsDevice,q).add(lA),this.on("beforeremove",this.onBeforeRemove,this),this.app.on("framerender",this.onFrameRender,this)}onFrameRender(){this.app.renderer.gsplatDirector?.updateStreaming()}initializeComponentData(e,t,s){t.layers&&t.layers.length&&(t.layers=t.layers.slice(0));for(let r=0;r<Qn.length;r++)t.hasOwnProperty(Qn[r])&&(e[Qn[r]]=t[Qn[r]]);t.aabbCenter&&t.aabbHalfExtents&&(e.customAabb=new J(new y(t.aabbCenter),new y(t.aabbHalfExtents))),super.initializeComponentData(e,t)}cloneComponent(e,t){let s=e.gsplat,r={};Qn.forEach(a=>{if(a==="material"){if(!s.unified){let o=s[a];o&&(r[a]=o.clone())}}else r[a]=s[a]}),r.enabled=s.enabled;let i=this.addComponent(t,r);return i.customAabb=s.customAabb?.clone()??null,i}onBeforeRemove(e,t){t.onBeforeRemove()}getMaterial(e,t){let s=this.app.renderer.gsplatDirector;if(!s)return null;let r=s.camerasMap.get(e);return r?r.layersMap.get(t)?.gsplatManager?.material??null:null}getGSplatMaterial(e,t){return this.getMaterial(e,t)}destroy(){super.destroy(),this.app.off("framerender",this.onFrameRender,this),this.app.renderer.gsplatDirector?.destroy(),this.app.renderer.gsplatDirector=null,this.app.scene.setGsplatParams(null),this._containerHandler&&(uA(this._containerHandler,Qp.name),this._containerHandler=null)}};function mA(l){let e=l>>10&31,t=l&1023;return(l&32768?-1:1)*(e===31?t?NaN:1/0:e?2**(e-15)*(1+t/1024):2**-24*t)}var bf=l=>Math.ceil(3*((l+1)**2-1)/8);var e_=new Float32Array(1),Jp=new Uint32Array(e_.buffer),fI=2**-1;function pA(l){e_[0]=l;let e=Jp[0],t=e>>>16&32768,s=e&2147483647;return s>=1199570944?t|(s>2139095040?32256:31744):s<947912704?(Jp[0]=s,e_[0]+=fI,t|Jp[0]-1056964608):t|s-939524096+4095+(s>>>13&1)>>>13}var cse=Float32Array.from({length:65536},(l,e)=>mA(e));var _A=`
uniform vec4 viewport_size;
bool initCorner(SplatSource source, SplatCenter center, out SplatCorner corner) {
	vec4 q = getRotation().yzwx;
	vec3 s = getScale();
	mat3 R = quatToMat3(q.wxyz);
	mat3 T = mat3(center.modelView) * mat3(s.x * R[0], s.y * R[1], s.z * R[2]);
	vec2 focal = viewport_size.xy * vec2(center.projMat00, center.projMat11) * 0.5;
	vec3 v = center.view.xyz;
	vec2 limit = 1.3 / vec2(center.projMat00, center.projMat11);
	vec2 t = clamp(v.xy / v.z, -limit, limit);
	vec3 a = vec3(focal.x / v.z, 0.0, -focal.x * t.x / v.z) * T;
	vec3 b = vec3(0.0, focal.y / v.z, -focal.y * t.y / v.z) * T;
	float xx = dot(a, a) + 0.3, xy = dot(a, b), yy = dot(b, b) + 0.3;
	float opacity = getOpacity();
#if GSPLAT_AA
	corner.aaFactor = max(sqrt(max((xx - 0.3) * (yy - 0.3) - xy * xy, 0.0) / (xx * yy - xy * xy)), 0.001);
	opacity *= corner.aaFactor;
#endif
	float middle = 0.5 * (xx + yy), radius = length(vec2(0.5 * (xx - yy), xy));
	float l1 = middle + radius, l2 = max((xx * yy - xy * xy) / l1, 1e-6);
	float reach = sqrt(2.0 * max(log(opacity * 255.0), 0.0));
	vec2 axis = abs(xy) > 1e-9 ? normalize(vec2(xy, l1 - xx)) : (xx >= yy ? vec2(1.0, 0.0) : vec2(0.0, 1.0));
	corner.uv = source.cornerUV * reach;
	vec2 pixels = corner.uv.x * sqrt(l1) * axis + corner.uv.y * sqrt(l2) * vec2(axis.y, -axis.x);
	corner.offset = vec3(pixels * center.proj.ww * viewport_size.zw * 2.0, 0.0);
	return reach > 0.0;
}`,gA=`
#include "gsplatHelpersVS"
#include "gsplatFormatVS"
#include "gsplatStructsVS"
#include "gsplatDeclarationsVS"
#include "gsplatModifyVS"
#include "gsplatEvalSHVS"
#include "gsplatQuatToMat3VS"
#include "gsplatReadVS"
#include "gsplatSourceVS"
#include "gsplatCenterVS"
#include "gsplatCornerVS"
#include "gsplatOutputVS"
uniform float alphaClipForward;
void clipCorner(inout SplatCorner corner, float alpha) {}
`,SA=`
varying highp vec2 gaussianUV;
flat varying mediump vec4 gaussianColor;
void main(void) {
	float alpha = min(exp(-0.5 * dot(gaussianUV, gaussianUV)) * gaussianColor.a, 0.99);
	if (alpha < 1.0 / 255.0) discard;
	gl_FragColor = vec4(gaussianColor.xyz * alpha, alpha);
}`;function TA(l){let e=(l+1)**2-1,t=bf(l),s=Array.from({length:t},(o,n)=>`uvec4 t${n} = loadDataSh${n}();`).join(`
	`),r=o=>`unpackHalf2x16(t${o>>3}.${"xyzw"[o>>1&3]}).${"xy"[o&1]}`,i=Array.from({length:e},(o,n)=>`sh[${n}] = vec3(${r(3*n)}, ${r(3*n+1)}, ${r(3*n+2)});`);return`
vec4 cachedCenter;
vec3 getCenter() { cachedCenter = loadDataCenter(); return cachedCenter.xyz; }
vec4 getColor() { vec4 color = loadDataColor(); return vec4(color.rgb, cachedCenter.w > 0.0 ? color.a : 0.0); }
vec3 getScale() { return loadDataScale().xyz * max(cachedCenter.w, 1e-3); }
vec4 getRotation() { return loadDataRotation(); }
${e?`
void readSHData(out vec3 sh[${e}], out float scale) {
	${s}
	${i.join(`
	`)}
	scale = 1.0;
}`:""}`}var _o=16;function t_(l,e){let t=[{name:"dataCenter",format:We},{name:"dataColor",format:ge},{name:"dataScale",format:ge},{name:"dataRotation",format:ge},...Array.from({length:bf(e)},(s,r)=>({name:`dataSh${r}`,format:Je}))];return new Gs(l,t,{readGLSL:TA(e),readWGSL:""})}var go=class extends Fn{constructor(t,s,r,i=t_(t,r)){super(t,s,i);this.capacity=s;this.degree=r;this.#e=new Float32Array(s),this.gsplatData.shBands=r,this.aabb=new J(new y(0,0,0),new y(_o,_o,_o)),this.centers.fill(_o)}capacity;degree;count=0;#e;clear(){this.count=0}add({count:t,centers:s,colours:r,scales:i,turns:a,harmonics:o,opacities:n}){let h=[...Object.entries({dataCenter:s,dataColor:r,dataScale:i,dataRotation:a}),...o.map((d,f)=>[`dataSh${f}`,d])];for(let[d,f]of h)this.#s(d).set(f,4*this.count),this.#t(d).unlock();this.#e.set(n,this.count);for(let d=0,f=3*this.count;d<s.length;d+=4,f+=3)for(let u=0;u<3;u++)this.centers[f+u]=Math.min(Math.max(s[d+u],-_o),_o);this.count+=t,this.update(this.count)}setGains(t){let s=this.#s("dataCenter"),r=this.#s("dataColor"),i=Math.min(t.length/2,this.count);for(let a=0;a<i;a++)s[4*a+3]=t[2*a],r[4*a+3]=pA(Math.min(this.#e[a]*t[2*a+1],1));this.#t("dataCenter").unlock(),this.#t("dataColor").unlock()}configureMaterialDefines(t){t.set("SH_BANDS",this.degree)}#t(t){return this.getTexture(t)}#s(t){return this.#t(t).lock()}};var Sse=new fe().setFromEulerAngles(0,0,180),uI=50,mI=40,pI=90;function s_(l,e){let t=s=>Math.tan(s*Math.PI/360);return Math.min(Math.max(t(uI),t(mI)*e/Math.max(l,1)),t(pI))}var _I=.25;function EA({position:l,rotation:e},t,s,r){let i=(o,n,c)=>{let h=e.transformVector(new y(o,n,c),new y);return[h.x,h.y,h.z,-(h.x*l.x+h.y*l.y+h.z*l.z)*t]},a=r/2/s_(s,r);return{viewmat:[i(1,0,0),i(0,-1,0),i(0,0,-1)],focal:a,width:s,height:r,margin:_I*Math.max(s,r)}}var Ff=null,yA=[];function CA(){let{setImmediate:l}=globalThis;if(l)return new Promise(t=>l(t));Ff||(Ff=new MessageChannel,Ff.port1.onmessage=()=>yA.shift()?.());let{port2:e}=Ff;return new Promise(t=>{yA.push(t),e.postMessage(null)})}var SI=100,Of=class{constructor(e,t){this.app=e;this.changed=t}app;changed;#e=new Map;#t=new Map;#s=[];#r=new Set;#i=[];#o=null;#n=null;#a=!1;get count(){let e=0;for(let{gaussians:t}of this.#e.values())e+=t.count;return e}get settled(){return!this.#n}recut(e,t){this.#s.push({gone:e,come:t}),this.#n??=this.#l().finally(()=>this.#n=null)}async#l(){let e=performance.now(),t=e;for(let s=this.#s.shift();s&&!this.#a;s=this.#s.shift()){for(let r of s.gone)this.#d(r)||this.#r.add(r);for(let{tile:r,packed:i}of s.come){if(performance.now()-e>8){if(await CA(),this.#a)return;e=performance.now()}this.#o??=t_(this.app.graphicsDevice,i.degree);let a=new go(this.app.graphicsDevice,i.count,i.degree,this.#o);a.add(i),this.#r.delete(r),this.#t.set(r,a)}(!this.#s.length||performance.now()-t>SI)&&(this.#f(),t=performance.now())}}#d(e){let t=this.#t.get(e);return this.#t.delete(e),t?.destroy(),t!==void 0&&!this.#e.has(e)}#f(){for(let e of[...this.#r,...this.#t.keys()]){let t=this.#e.get(e);t&&(t.entity.destroy(),this.#i.push(t.gaussians),this.#e.delete(e))}for(let[e,t]of this.#t){let s=new as(`tile ${e}`,this.app);this.app.root.addChild(s),s.addComponent("gsplat",{resource:t}),this.#e.set(e,{entity:s,gaussians:t})}this.#r.clear(),this.#t.clear(),this.changed()}again(){let e=this.#e.values().next().value;e&&(e.entity.gsplat.workBufferUpdate=Ri)}sorted(){if(!this.#n)for(let e of this.#i.splice(0))e.destroy()}setGains(e){if(e&&e.length!==2*this.count)return;let t=0;for(let[,{gaussians:s,entity:r}]of[...this.#e].sort(([i],[a])=>i-a)){let{count:i}=s;s.setGains(e?e.subarray(t,t+2*i):new Float32Array(2*i).fill(1)),r.gsplat.workBufferUpdate=Ri,t+=2*i}}destroy(){this.#a=!0;for(let{entity:t}of this.#e.values())t.destroy();let e=[...this.#t.values(),...this.#i,...[...this.#e.values()].map(({gaussians:t})=>t)];for(let t of e)t.destroy();this.#e.clear(),this.#t.clear(),this.#i=[]}};var TI=4096,r_=5e3,EI=r_,Nf=class{constructor(e,t){this.canvas=e;this.orbit=t;let s=new jo(e,{antialias:!1,alpha:!1,powerPreference:"high-performance"}),r=new zn;r.graphicsDevice=s,r.componentSystems=[Hn,Jn],this.#e=new Vn(e),this.#e.init(r),this.#e.setCanvasFillMode(AT),this.#e.autoRender=!1,this.#t=new as("camera",this.#e),this.#s=new as("scene",this.#e);let i=this.#e.scene.gsplat;i.dataFormat=Hg,i.colorUpdateAngle=.1;let a=i.material.getShaderChunks("glsl");a.set("gsplatCornerVS",_A),a.set("gsplatCommonVS",gA),a.set("gsplatPS",SA),i.material.update(),this.#t.addComponent("camera",{nearClip:.01,farClip:2e3,toneMapping:Xr,gammaCorrection:Wr}),this.#e.root.addChild(this.#t),this.#e.root.addChild(this.#s),this.#e.on("update",()=>this.#v()),this.#e.systems.gsplat.on("frame:request",()=>this.touch()),this.#e.scene.on("gsplat:sorted",()=>{this.#m=!0,this.#p&&this.touch()}),this.#e.systems.gsplat.on("frame:ready",(o,n,c)=>this.#y(c)),this.#e.on("postrender",()=>this.#A()),this.#e.on("frameend",()=>this.#E()),this.resize(),this.#e.start()}canvas;orbit;#e;#t;#s;#r=null;#i=null;#o=[];#n=1;#a=null;#l=null;#d=[];#f=[];#_=[];#m=!1;#T=new N;#p=!1;#c=!1;#u=!1;#g=0;#S=!1;watcher=null;get count(){return this.#i?.count??this.#r?.count??0}destroy(){if(this.#u)return;this.#u=!0;let{gl:e}=this.#e.graphicsDevice;this.#s.gsplat&&this.#s.removeComponent("gsplat"),this.#r?.destroy(),this.#i?.destroy(),this.#e.destroy(),e.getExtension("WEBGL_lose_context")?.loseContext(),this.canvas.remove();for(let t of[this.#d,this.#f,this.#_])for(let s of t.splice(0))s()}touch(){this.#u||(this.#e.renderNextFrame=!0,this.#g=performance.now(),this.#S&&(this.#S=!1,this.#e.requestAnimationFrame()))}#E(){let e=this.#e;performance.now()-this.#g<EI||this.#e.renderNextFrame||(cancelAnimationFrame(e.frameRequestId),this.#S=!0)}resize(e=Math.min(window.devicePixelRatio,2)){if(this.#u)return;let{canvas:t}=this,s=this.#l,r=Math.max(t.clientWidth,1),i=Math.max(t.clientHeight,1),a=s?s.height:Math.max(Math.round(i*e),1),o=Math.max(Math.round(s?s.width??a*r/i:r*e),1),n=s?a/2/s.focal:s_(o,a);this.#t.camera.fov=2*Math.atan(n)*180/Math.PI,this.#e.setCanvasResolution(Fd,o,a),this.touch()}background([e,t,s]){this.#t.camera.clearColor=new z(e,t,s,1),this.touch()}antialias(e){this.#e.scene.gsplat.antiAlias=e,this.#h()}begin(e){this.#o=[],this.#a=null,this.#i?.destroy(),this.#i=null,this.#n=e,this.#s.gsplat&&this.#s.removeComponent("gsplat"),this.#r?.destroy(),this.#r=null}add(e,t=!1){t&&(this.#o=[],this.#a=null,this.#r?.clear(),this.#c=this.#r!==null),this.#o.push(e);let s=this.#o.reduce((r,i)=>r+i.count,0);!this.#r||this.#r.capacity<s?this.#C(s,e.degree):this.#r.add(e),this.#h()}recut(e,t){this.#i??=new Of(this.#e,()=>this.touch()),this.#c=!0,this.#i.recut(e,t)}setGains(e){this.#a=e,this.#i?.setGains(e),this.#r?.setGains(e??new Float32Array(2*this.count).fill(1)),this.#h()}get camera(){let{width:e,height:t}=this.canvas,s=this.#l;return s?{viewmat:s.viewmat,focal:s.focal*t/s.height,width:e,height:t,margin:0}:EA(this.orbit.pose(),this.#n,e,t)}fix(e){this.#l=e,this.resize(),this.#h()}frame(){return this.touch(),this.#u?Promise.resolve():new Promise(e=>this.#d.push(e))}sorted(){return this.touch(),new Promise(e=>{this.#f.push(e),setTimeout(e,r_)})}steady(){return this.#c?(this.touch(),new Promise(e=>{this.#_.push(e),setTimeout(e,r_)})):Promise.resolve()}#y(e){if(!(!e||!this.#c||this.#i?.settled===!1)){this.#c=!1,this.#i?.sorted(),this.#h();for(let t of this.#_.splice(0))t()}}#h(){let e=this.#s.gsplat;e&&!this.#c&&(e.workBufferUpdate=Ri),this.#i?.again(),this.touch()}#C(e,t){let s=Math.max(TI,2**Math.ceil(Math.log2(e))),r=new go(this.#e.graphicsDevice,s,t);for(let i of this.#o)r.add(i);this.#a&&r.setGains(this.#a),this.#s.gsplat&&this.#s.removeComponent("gsplat"),this.#s.addComponent("gsplat",{resource:r}),this.#r?.destroy(),this.#r=r}#v(){if(this.#l)yI(this.#t,this.#l.viewmat,this.#n);else{let{position:e,rotation:t}=this.orbit.pose();this.#t.setPosition(e.x,e.y,e.z),this.#t.setRotation(t.x,t.y,t.z,t.w)}this.#x(),this.watcher?.(this.camera)}#x(){let e=this.#t.getWorldTransform();e.equals(this.#T)?this.#p&&this.#m&&(this.#p=!1,this.#h()):(this.#T.copy(e),this.#p=!0)}#A(){this.#g=performance.now();for(let e of this.#d.splice(0))e();if(this.#m){this.#m=!1;for(let e of this.#f.splice(0))e()}}};function yI(l,[e,t,s],r){let i=[0,1,2].map(o=>-(e[o]*e[3]+t[o]*t[3]+s[o]*s[3])/r),a=new N().set([e[0],e[1],e[2],0,-t[0],-t[1],-t[2],0,-s[0],-s[1],-s[2],0,0,0,0,1]);l.setPosition(i[0],i[1],i[2]),l.setRotation(new fe().setFromMat4(a))}globalThis.splatwireView=Nf;
