// SPDX-FileCopyrightText: 2026 CU-Recon authors
// SPDX-License-Identifier: GPL-3.0-or-later
// What the pages say, in English and Chinese, and the button that changes between them.

const WORDS = {
  en: {
    other: "中文", sites: "Sites", search: "Search sites", fromYear: "From year", toYear: "To year", one: "1 site", many: "{} sites", nothing: "No site is called that.",
    outline: "Land: Natural Earth", onMap: "Show on the map", exact: "Exact place", cell: "Somewhere in a square of 1 km",
    hidden: "Place not shown", unknown: "Place not known", view: "The site in 3D", map: "All sites", loading: "Loading", home: "Whole site",
    measure: "Measure", section: "Section", filled: "Mark guesses", cloud: "Point cloud", surface: "Surface", link: "Copy link", about: "About",
    level: "Level", upright: "Upright", place: "Place", turn: "Direction", copied: "The link to this view is copied.",
    linkHere: "The link to this view:", pick: "Click two places on the site.", pickSecond: "Height above the site's zero: {}. Click a second place.",
    measured: "Distance {}, level {}, height {}.", coarse: "Only a coarse surface is loaded there: ± {}.",
    missed: "There is no surface at that place.", noScale: "The scale of this site is unknown: do not measure.", units: "units",
    doubt: "Heights of this site are doubtful.", failed: "A part of the site could not be loaded. Load the page again.",
    noSite: "This site could not be loaded.", noWebGL: "This browser cannot show 3D pictures (WebGL).",
    cutLevel: "Shown up to {}", cutUpright: "Cut at {}, facing {}°", credit: "Recorded by", licence: "Licence", taken: "Photos of", where: "Where",
    size: "Surface", faces: "{} triangles", points: "Cloud", pointsOf: "{} of {} points", 
    filledSaid: "{} % of the surface was not measured by any photo. It was filled in, and is marked in orange.",
    weakSaid: "{} % was measured by one photo alone.",
    unseenSaid: "No photo shows the colour of {} %. Where it was measured all the same, it is marked in violet.",
    nothingFilled: "All of the surface was measured, and photos show its colour.", exactness: "How exact", pixel: "A photo's pixel", reprojection: "Reprojection error", pixels: "{} pixels",
    sigma: "Precision within the site", sigmaSaid: "{} in plan, {} in height", seen: "Seen by three photos or more", check: "Check points, RMS",
    control: "Control points, RMS", noFigures: "No accuracy report was published.", report: "The full accuracy report (PDF)", notes: "Notes",
    pictures: "Pictures", film: "Film", keys: "Keys", keysSaid: "turn; + − nearer, farther; H whole site; M measure; S section; F guesses; C cloud; Esc end",
    madeBy: "Made by CU-Recon", licences: "Licences of the software", vertexColours: "The surface has no texture: its colours are those of its vertices.",
    noSurface: "There is no surface of this site: the point cloud is shown.", more: "Show more", feed: "Feed", contribute: "Add a site",
    register: "Register", period: "Period", tags: "Tags", versions: "Versions", version: "{}, accepted {}", older: "This is an older version.",
    newest: "The newest version", embed: "To show it in another page",
  },
  zh: {
    other: "English", sites: "遗址", search: "搜索遗址", fromYear: "起始年份", toYear: "结束年份", one: "1 处遗址", many: "{} 处遗址", nothing: "没有这个名称的遗址。",
    outline: "陆地轮廓：Natural Earth", onMap: "在地图上显示", exact: "准确位置", cell: "位于 1 公里方格内某处",
    hidden: "不公开位置", unknown: "位置未知", view: "遗址三维视图", map: "全部遗址", loading: "正在加载", home: "全景",
    measure: "测量", section: "剖切", filled: "标出推测", cloud: "点云", surface: "表面", link: "复制链接", about: "关于",
    level: "水平", upright: "竖直", place: "位置", turn: "方向", copied: "已复制此视图的链接。",
    linkHere: "此视图的链接：", pick: "请在遗址上点击两处。", pickSecond: "高于遗址零点：{}。请点击第二处。",
    measured: "距离 {}，水平 {}，高差 {}。", coarse: "该处只加载了粗略表面：± {}。",
    missed: "该处没有表面。", noScale: "此遗址的比例未知：请勿测量。", units: "单位",
    doubt: "此遗址的高度存疑。", failed: "遗址的一部分无法加载。请重新加载页面。",
    noSite: "无法加载此遗址。", noWebGL: "此浏览器无法显示三维图形（WebGL）。",
    cutLevel: "显示至 {}", cutUpright: "剖切于 {}，朝向 {}°", credit: "记录者", licence: "许可", taken: "拍摄日期", where: "地点",
    size: "表面", faces: "{} 个三角形", points: "点云", pointsOf: "{} 个点，共 {} 个", 
    filledSaid: "表面的 {} % 没有任何照片测量到，是填补的，以橙色标出。",
    weakSaid: "{} % 仅由一张照片测量到。",
    unseenSaid: "没有照片显示 {} % 的颜色；其中已测量的部分以紫色标出。",
    nothingFilled: "表面全部经过测量，颜色均来自照片。", exactness: "精确程度", pixel: "照片像素", reprojection: "重投影误差", pixels: "{} 像素",
    sigma: "遗址内部精度", sigmaSaid: "平面 {}，高度 {}", seen: "三张以上照片可见", check: "检查点均方根误差",
    control: "控制点均方根误差", noFigures: "没有发布精度报告。", report: "完整精度报告（PDF）", notes: "注记",
    pictures: "图片", film: "影片", keys: "按键", keysSaid: "旋转；+ − 拉近、拉远；H 全景；M 测量；S 剖切；F 推测；C 点云；Esc 结束",
    madeBy: "由 CU-Recon 制作", licences: "软件许可", vertexColours: "表面没有纹理：颜色取自顶点。",
    noSurface: "此遗址没有表面：显示点云。", more: "显示更多", feed: "订阅", contribute: "上传遗址",
    register: "登记号", period: "年代", tags: "标签", versions: "版本", version: "{}，{} 收录", older: "这是较早的版本。",
    newest: "最新版本", embed: "嵌入其他网页",
  },
};
const KEPT = "curecon-language";

document.getElementById("served")?.remove(); // this runs: the page came from a web server

let language = (kept() || navigator.language).toLowerCase().startsWith("zh") ? "zh" : "en";

function kept() {
  try {
    return localStorage.getItem(KEPT);
  } catch {
    return null; // a browser that keeps nothing
  }
}

/** Words that another page says beside these: {en: {...}, zh: {...}}. */
export function learn(words) {
  for (const [name, said] of Object.entries(words)) Object.assign(WORDS[name], said);
}

/** The word's text, its {} filled in order. */
export function say(word, ...values) {
  let next = 0;
  return WORDS[language][word].replace(/\{\}/g, () => values[next++]);
}

/** Say everything on the page in its language, now and whenever that changes; `told` is called each time. */
export function speak(told) {
  const button = document.getElementById("language");
  const all = () => {
    document.documentElement.lang = language === "zh" ? "zh-Hans" : "en";
    button.textContent = say("other");
    for (const one of document.querySelectorAll("[data-word]")) one.textContent = say(one.dataset.word);
    for (const one of document.querySelectorAll("[data-word-label]")) one.setAttribute("aria-label", say(one.dataset.wordLabel));
    for (const one of document.querySelectorAll("[data-word-placeholder]")) one.placeholder = say(one.dataset.wordPlaceholder);
    told();
  };
  button.addEventListener("click", () => {
    language = language === "zh" ? "en" : "zh";
    try {
      localStorage.setItem(KEPT, language);
    } catch {
      // the choice lasts as long as the page
    }
    all();
  });
  all();
}

/** An element with a text: names and titles are never read as HTML. */
export function element(name, text = "", facts = {}) {
  const made = document.createElement(name);
  made.textContent = text;
  for (const [key, value] of Object.entries(facts)) made.setAttribute(key, value);
  return made;
}
