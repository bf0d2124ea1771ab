"""Sentences of CLEVR's language: the forms of questions, the synonyms of values, the names of relations.

In a form, {…} is a slot that `wording` fills, […] is said every other time, and a question begins with a capital and
ends with a question mark. `a` and `b` are the phrases of a family: "{the a}" is "the large ball behind the red cube",
"{an a}" is "a large ball …", "{all a}" is "large balls …". "{intro}" introduces the reference of phrase `a` ("a red
cube"), to which "it" refers where a slot ends in "it". "{nouns}" is phrase `a` up to its noun, and "{where}" is what
follows the noun.
"""

THINGS = ("thing", "object")
SYNONYMS = {
    "large": ("large", "big"),
    "small": ("small", "tiny"),
    "metal": ("metal", "metallic", "shiny"),
    "rubber": ("rubber", "matte"),
    "cube": ("cube", "block"),
    "sphere": ("sphere", "ball"),
}
"""What values are called that have more than one name."""

RELATIONS = {
    "left": ("left of", "to the left of", "on the left side of"),
    "right": ("right of", "to the right of", "on the right side of"),
    "front": ("in front of",),
    "behind": ("behind",),
}

HOW_MANY = ("how many", "what number of")

COUNT = {
    "scene": ("{how many} {nouns} are there",),
    "relate": ("{how many} {nouns} are {where}", "there is {intro}; {how many} {nouns} are {where it}"),
    "same": ("{how many} other {nouns} {where}", "there is {intro}; {how many} other {nouns} {where it}"),
    "both": ("{how many} {nouns} are {where}",),
    "either": ("{how many} {nouns} are [either] {where}",),
}
"""How a number is asked for, by the source of the phrase."""

EXIST = {
    "scene": ("are there any {all a}", "is there {an a}", "are any {all a} visible"),
    "relate": (
        "are there any {all a}",
        "is there {an a}",
        "there is {intro}; are there any {all a it}",
        "there is {intro}; is there {an a it}",
    ),
    "same": (
        "are there any {all a}",
        "is there {an a}",
        "there is {intro}; are there any {all a it}",
        "there is {intro}; is there {an a it}",
    ),
}
"""How existence is asked for, by the source of the phrase."""

QUERY = {
    "size": (
        "what size is {the a}",
        "what is the size of {the a}",
        "how big is {the a}",
        "{the a} has what size",
        "{the a} is what size",
        "there is {an a}; what size is it",
        "there is {an a}; what is its size",
        "there is {an a}; how big is it",
    ),
    "color": (
        "what color is {the a}",
        "what is the color of {the a}",
        "{the a} has what color",
        "{the a} is what color",
        "there is {an a}; what color is it",
        "there is {an a}; what is its color",
    ),
    "material": (
        "what material is {the a}",
        "what is the material of {the a}",
        "what is {the a} made of",
        "what [material] is {the a} made of",
        "{the a} is made of what material",
        "there is {an a}; what is it made of",
        "there is {an a}; what material is it made of",
        "there is {an a}; what is its material",
    ),
    "shape": (
        "what shape is {the a}",
        "what is the shape of {the a}",
        "{the a} has what shape",
        "{the a} is what shape",
        "there is {an a}; what shape is it",
        "there is {an a}; what is its shape",
    ),
}
"""How each attribute of an object is asked for."""

EQUAL = (
    "do {the a} and {the b} have the same {attribute}",
    "does {the a} have the same {attribute} as {the b}",
    "is {the a} the same {attribute} as {the b}",
    "is the {attribute} of {the a} the same as {the b}",
    "there is {an a}; does it have the same {attribute} as {the b}",
    "there is {an a}; is it the same {attribute} as {the b}",
    "there is {an a}; is its {attribute} the same as {the b}",
)
"""How two objects are compared. "is … the same material as" is no English: `MADE_OF` says it."""
MADE_OF = (
    "do {the a} and {the b} have the same material",
    "does {the a} have the same material as {the b}",
    "are {the a} and {the b} made of the same material",
    "is {the a} made of the same material as {the b}",
    "is the material of {the a} the same as {the b}",
    "there is {an a}; does it have the same material as {the b}",
    "there is {an a}; is it made of the same material as {the b}",
    "there is {an a}; is its material the same as {the b}",
)

INTEGERS = {
    "equal_integer": (
        "are there an equal number of {all a} and {all b}",
        "are there the same number of {all a} and {all b}",
        "is the number of {all a} the same as the number of {all b}",
    ),
    "less_than": (
        "are there fewer {all a} than {all b}",
        "is the number of {all a} less than the number of {all b}",
    ),
    "greater_than": (
        "are there more {all a} than {all b}",
        "is the number of {all a} greater than the number of {all b}",
    ),
}
"""How two numbers are compared."""

SHARING = {
    True: ("have the same {attribute} as {reference}", "are the same {attribute} as {reference}"),
    False: ("has the same {attribute} as {reference}", "is the same {attribute} as {reference}"),
}
"""What several objects (True) or one object share with a reference."""
SHARING_MATERIAL = {
    True: ("have the same material as {reference}", "are [made of] the same material as {reference}"),
    False: ("has the same material as {reference}", "is [made of] the same material as {reference}"),
}
