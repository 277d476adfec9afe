// SPDX-FileCopyrightText: 2026 CU-Recon authors
// SPDX-License-Identifier: GPL-3.0-or-later
// What the pages of people with an account say beside what the public ones do.

import { learn } from "../pages/words.js";

learn({
  en: {
    desk: "Contributors", mine: "My sites", upload: "Upload", moderate: "Moderate", audit: "Log", account: "Account",
    signIn: "Sign in", signOut: "Sign out", join: "Join", name: "Name", password: "Password", joinSaid: "You were invited. Choose a name and a password of 10 letters or more.",
    invitedOnly: "Accounts are by invitation: ask a moderator of this atlas.", nothingYet: "There is nothing here yet.",
    held: "waits for a moderator", accepted: "accepted", refused: "refused", withdrawn: "withdrawn", removed: "taken down", public: "public",
    open: "not finished", giveUp: "Give up", withdraw: "Withdraw", takeDown: "Take down", view: "View", why: "Why", whyAsked: "Why? The contributor reads it.",
    takeDownAsked: "Take the site down, with all its versions? This cannot be undone.", yes: "Yes, take it down", no: "No", done: "Done.",
    choose: "The published folder (Publish Web Pages wrote it)", whichSite: "Site", register: "Number in a heritage register", tags: "Tags, with commas between",
    from: "From year", to: "To year", officials: "Leave the exact place for officials of the atlas. It is kept sealed.", latitude: "Latitude", longitude: "Longitude",
    send: "Upload", resumed: "Going on from where it stopped.", hashing: "Reading files …", sending: "{} of {} MB", checking: "The atlas checks the files …",
    sent: "The site waits for a moderator.", noSiteThere: "There is no published site in that folder.", cut: "The connection was lost. Press Upload again: it goes on from there.",
    accept: "Accept", refuse: "Refuse", look: "Look at it", by: "by {}", mb: "{} MB", waiting: "{} wait", invite: "Invite", role: "Role", contributor: "contributor",
    moderator: "moderator", official: "official", inviteLink: "Give this link to one person. It works once, for 14 days:", tokens: "Tokens for Blender",
    tokenSaid: "Put this token into CU-Recon's preferences in Blender. It is shown once:", newToken: "New token", label: "For which computer", end: "End it",
    until: "until {}", oldPassword: "Old password", newPassword: "New password", change: "Change the password", changed: "The password is changed. Sign in again.",
    when: "When", who: "Who", what: "What", older: "Older", place: "Exact place", placeAsked: "Site's name in its address", exactPlace: "{}, {}",
    code_sign_in: "The name or the password is wrong.", code_invitation: "This invitation was used, has run out, or never was.", code_taken: "Somebody has that name.",
    code_too_many: "That was tried too often. Wait a while.", code_session: "Sign in first.", code_decided: "Somebody has decided on it already.",
    code_full: "You have as many uploads open or held as there may be.", code_database: "The atlas does not answer. Try again.", code_disk: "The atlas has no room left.",
  },
  zh: {
    desk: "贡献者", mine: "我的遗址", upload: "上传", moderate: "审核", audit: "日志", account: "账户",
    signIn: "登录", signOut: "退出", join: "加入", name: "名称", password: "密码", joinSaid: "您已受邀。请选择名称和至少 10 个字符的密码。",
    invitedOnly: "账户仅限受邀：请联系本图集的审核员。", nothingYet: "这里还没有内容。",
    held: "等待审核", accepted: "已收录", refused: "已拒绝", withdrawn: "已撤回", removed: "已撤下", public: "公开",
    open: "未完成", giveUp: "放弃", withdraw: "撤回", takeDown: "撤下", view: "查看", why: "原因", whyAsked: "原因？贡献者会看到。",
    takeDownAsked: "撤下此遗址及其所有版本？此操作无法撤销。", yes: "是，撤下", no: "否", done: "完成。",
    choose: "已发布的文件夹（由“发布网页”写出）", whichSite: "遗址", register: "文物登记号", tags: "标签，以逗号分隔",
    from: "起始年份", to: "结束年份", officials: "将准确位置留给本图集的官员。位置将加密保存。", latitude: "纬度", longitude: "经度",
    send: "上传", resumed: "从中断处继续。", hashing: "正在读取文件……", sending: "{} / {} MB", checking: "图集正在检查文件……",
    sent: "遗址正在等待审核。", noSiteThere: "该文件夹中没有已发布的遗址。", cut: "连接中断。请再次点击上传：将从中断处继续。",
    accept: "收录", refuse: "拒绝", look: "查看内容", by: "由 {} 上传", mb: "{} MB", waiting: "{} 项等待", invite: "邀请", role: "角色", contributor: "贡献者",
    moderator: "审核员", official: "官员", inviteLink: "将此链接交给一个人。可用一次，14 天内有效：", tokens: "Blender 令牌",
    tokenSaid: "将此令牌填入 Blender 中 CU-Recon 的偏好设置。只显示一次：", newToken: "新令牌", label: "用于哪台电脑", end: "终止",
    until: "有效期至 {}", oldPassword: "旧密码", newPassword: "新密码", change: "更改密码", changed: "密码已更改。请重新登录。",
    when: "时间", who: "用户", what: "操作", older: "更早", place: "准确位置", placeAsked: "遗址在网址中的名称", exactPlace: "{}, {}",
    code_sign_in: "名称或密码错误。", code_invitation: "此邀请已使用、已过期或不存在。", code_taken: "该名称已被使用。",
    code_too_many: "尝试过于频繁。请稍候。", code_session: "请先登录。", code_decided: "已有人作出决定。",
    code_full: "您未完成或等待审核的上传已达上限。", code_database: "图集没有响应。请重试。", code_disk: "图集空间不足。",
  },
});
