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
    takeDownAsked: "Take the site down, with all its versions? This cannot be undone.", accounts: "Accounts", close: "Close", closeAsked: "Close this account? It can no longer sign in. Its sites stay.", yes: "Yes", no: "No", done: "Done.",
    choose: "The published folder (Publish Web Pages wrote it)", whichSite: "Site", register: "Number in a heritage register", tags: "Tags, with commas between",
    from: "From year", to: "To year", officials: "Leave the exact place for officials of the atlas. It is kept sealed.", latitude: "Latitude", longitude: "Longitude",
    send: "Upload", hashing: "Reading files …", sending: "{} of {} MB", checking: "The atlas checks the files …",
    sent: "The site waits for a moderator.", noSiteThere: "There is no published site in that folder.", cut: "The atlas does not answer. Try again: an upload goes on from where it stopped.",
    accept: "Accept", refuse: "Refuse", look: "Look at it", by: "by {}", mb: "{} MB", invite: "Invite", role: "Role", contributor: "contributor",
    moderator: "moderator", official: "official", inviteLink: "Give this link to one person. It works once, for 14 days:", tokens: "Tokens for Blender",
    tokenSaid: "Put this token into CU-Recon's preferences in Blender. It is shown once:", newToken: "New token", label: "For which computer", end: "End it",
    until: "until {}", oldPassword: "Old password", newPassword: "New password", change: "Change the password", changed: "The password is changed. Sign in again.",
    when: "When", who: "Who", what: "What", older: "Older", place: "Exact place", placeAsked: "Site's name in its address", exactPlace: "{}, {}",
    did_upload: "began an upload", did_drop: "gave an upload up", did_hold: "uploaded", did_accepted: "accepted", did_refused: "refused",
    did_withdrawn: "withdrew", did_remove: "took down", did_place: "asked for an exact place", did_invite: "invited", did_join: "joined",
    did_sign_in: "signed in", did_token: "made a token", did_revoke: "ended a token", did_password: "changed the password", did_close: "closed an account", did_survey: "opened a survey",
    answered: "The atlas answers {}. Try again later.",
  },
  zh: {
    desk: "贡献者", mine: "我的遗址", upload: "上传", moderate: "审核", audit: "日志", account: "账户",
    signIn: "登录", signOut: "退出", join: "加入", name: "名称", password: "密码", joinSaid: "您已受邀。请选择名称和至少 10 个字符的密码。",
    invitedOnly: "账户仅限受邀：请联系本图集的审核员。", nothingYet: "这里还没有内容。",
    held: "等待审核", accepted: "已收录", refused: "已拒绝", withdrawn: "已撤回", removed: "已撤下", public: "公开",
    open: "未完成", giveUp: "放弃", withdraw: "撤回", takeDown: "撤下", view: "查看", why: "原因", whyAsked: "原因？贡献者会看到。",
    takeDownAsked: "撤下此遗址及其所有版本？此操作无法撤销。", accounts: "账户", close: "关闭", closeAsked: "关闭此账户？将无法再登录，其遗址保留。", yes: "是", no: "否", done: "完成。",
    choose: "已发布的文件夹（由“发布网页”写出）", whichSite: "遗址", register: "文物登记号", tags: "标签，以逗号分隔",
    from: "起始年份", to: "结束年份", officials: "将准确位置留给本图集的官员。位置将加密保存。", latitude: "纬度", longitude: "经度",
    send: "上传", hashing: "正在读取文件……", sending: "{} / {} MB", checking: "图集正在检查文件……",
    sent: "遗址正在等待审核。", noSiteThere: "该文件夹中没有已发布的遗址。", cut: "图集没有响应。请重试：上传将从中断处继续。",
    accept: "收录", refuse: "拒绝", look: "查看内容", by: "由 {} 上传", mb: "{} MB", invite: "邀请", role: "角色", contributor: "贡献者",
    moderator: "审核员", official: "官员", inviteLink: "将此链接交给一个人。可用一次，14 天内有效：", tokens: "Blender 令牌",
    tokenSaid: "将此令牌填入 Blender 中 CU-Recon 的偏好设置。只显示一次：", newToken: "新令牌", label: "用于哪台电脑", end: "终止",
    until: "有效期至 {}", oldPassword: "旧密码", newPassword: "新密码", change: "更改密码", changed: "密码已更改。请重新登录。",
    when: "时间", who: "用户", what: "操作", older: "更早", place: "准确位置", placeAsked: "遗址在网址中的名称", exactPlace: "{}, {}",
    did_upload: "开始上传", did_drop: "放弃上传", did_hold: "完成上传", did_accepted: "收录", did_refused: "拒绝",
    did_withdrawn: "撤回", did_remove: "撤下", did_place: "查询准确位置", did_invite: "邀请", did_join: "加入",
    did_sign_in: "登录", did_token: "新建令牌", did_revoke: "终止令牌", did_password: "更改密码", did_close: "关闭账户", did_survey: "开放问卷",
    answered: "图集返回 {}。请稍后再试。",
  },
});
