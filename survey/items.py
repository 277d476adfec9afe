# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What the questionnaire asks, in English and Chinese. The keys are the columns of an answer."""

from __future__ import annotations

from dataclasses import dataclass

LEAST, MOST = 1, 5  # of a rating
SATISFACTION = "satisfaction"


@dataclass(frozen=True)
class Words:
    en: str
    zh: str


@dataclass(frozen=True)
class Rating:
    """A statement about each result, agreed with from 1 to 5. `name` is what tables and other tools' headers call it.
    `skippable` ones may be left out by who cannot tell."""

    key: str
    name: Words
    statement: Words
    skippable: bool = False


@dataclass(frozen=True)
class Question:
    """A question about the respondent: its options by key."""

    key: str
    name: Words
    text: Words
    options: dict[str, Words]


SCALE = (
    Words("strongly disagree", "非常不同意"), Words("disagree", "不同意"), Words("undecided", "一般"),
    Words("agree", "同意"), Words("strongly agree", "非常同意"),
)
RATINGS = (
    Rating("clearness", Words("Clearness", "清晰度"),
           Words("Edges, joints and ornaments can be told apart.", "边缘、接缝和装饰清晰可辨。")),
    Rating("accuracy", Words("Accuracy", "准确度"),
           Words("Shapes and proportions are those of the real building.", "形状和比例与真实建筑一致。")),
    Rating("integrity", Words("Integrity", "完整度"),
           Words("The building is whole: no part is missing.", "建筑是完整的，没有缺失的部分。")),
    Rating("authenticity", Words("Authenticity", "真实度"),
           Words("Colours and materials look as they do on the real building.", "色彩和材质看起来与真实建筑一致。")),
    Rating("operation", Words("Operation", "操作性"),
           Words("The program that made this result is easy to use.", "生成该结果的软件易于使用。"), skippable=True),
    Rating(SATISFACTION, Words("Satisfaction", "满意度"),
           Words("All in all, I am satisfied with this result.", "总体而言，我对该结果感到满意。")),
)
ASPECTS = ("clearness", "accuracy", "integrity", "authenticity")  # one scale, whose reliability alpha tells
QUESTIONS = (
    Question("role", Words("Role", "身份"),
             Words("What do you mostly do with old buildings?", "您与古建筑的主要关系是？"), {
        "conservation": Words("conserve or manage them", "保护或管理"),
        "design": Words("design, build or repair", "设计、建造或修缮"),
        "surveying": Words("survey or record them", "测绘或记录"),
        "research": Words("teach, study or research", "教学、学习或研究"),
        "resident": Words("live in or own one", "居住或拥有"),
        "other": Words("something else", "其他"),
    }),
    Question("experience", Words("Experience", "从业年限"),
             Words("For how many years have you worked with heritage?", "您从事遗产相关工作多少年？"), {
        "none": Words("not at all", "没有"), "to2": Words("up to 2", "2年以内"), "to5": Words("3 to 5", "3至5年"),
        "to10": Words("6 to 10", "6至10年"), "over10": Words("more than 10", "10年以上"),
    }),
    Question("software", Words("3D software", "三维软件"),
             Words("How often do you use 3D software?", "您使用三维软件的频率？"), {
        "never": Words("never", "从不"), "rarely": Words("a few times a year or less", "每年几次或更少"),
        "often": Words("every month or more often", "每月或更频繁"),
    }),
    Question("age", Words("Age", "年龄"), Words("How old are you?", "您的年龄？"), {
        "18to29": Words("18 to 29", "18至29岁"), "30to44": Words("30 to 44", "30至44岁"),
        "45to59": Words("45 to 59", "45至59岁"), "from60": Words("60 or older", "60岁及以上"),
    }),
    Question("gender", Words("Gender", "性别"), Words("Your gender?", "您的性别？"), {
        "female": Words("female", "女"), "male": Words("male", "男"), "other": Words("another", "其他"),
    }),
)
NOT_SAID = "not said"  # every question may be left open


def folded(text: str) -> str:
    """A header's or cell's text as it is compared: without case, doubled spaces, and the forms of a colon."""
    return " ".join(text.replace("：", ":").replace("\ufeff", "").casefold().split())


def by_any_name(entries: dict[str, tuple[str, ...]]) -> dict[str, str]:
    """Each key by every name that it goes by, folded."""
    return {folded(name): key for key, names in entries.items() for name in (key, *names)}
