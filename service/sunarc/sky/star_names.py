"""Proper names of bright stars, by Hipparcos number."""

from __future__ import annotations

from sunarc.sky.night import STAR

# fmt: off
_NAMES = {
    677: "Alpheratz", 746: "Caph", 1067: "Algenib", 2081: "Ankaa", 3179: "Schedar", 3419: "Diphda", 5447: "Mirach",
    7588: "Achernar", 9640: "Almach", 9884: "Hamal", 11767: "Polaris", 13847: "Acamar", 14135: "Menkar", 14576:
    "Algol", 15863: "Mirfak", 17499: "Electra", 17531: "Taygeta", 17573: "Maia", 17608: "Merope", 17702: "Alcyone",
    17847: "Atlas", 18543: "Zaurak", 21421: "Aldebaran", 24436: "Rigel", 24608: "Capella", 25336: "Bellatrix",
    25428: "Elnath", 25606: "Nihal", 25930: "Mintaka", 25985: "Arneb", 26311: "Alnilam", 26727: "Alnitak", 27366:
    "Saiph", 27989: "Betelgeuse", 28360: "Menkalinan", 30324: "Mirzam", 30438: "Canopus", 31681: "Alhena", 32349:
    "Sirius", 33579: "Adhara", 34444: "Wezen", 36850: "Castor", 37279: "Procyon", 37826: "Pollux", 39429: "Naos",
    41037: "Avior", 44816: "Suhail", 45238: "Miaplacidus", 46390: "Alphard", 49669: "Regulus", 50583: "Algieba",
    53910: "Merak", 54061: "Dubhe", 57632: "Denebola", 58001: "Phecda", 59316: "Minkar", 59774: "Megrez", 59803:
    "Gienah", 60718: "Acrux", 61084: "Gacrux", 62434: "Mimosa", 62956: "Alioth", 63608: "Vindemiatrix", 65378:
    "Mizar", 65474: "Spica", 65477: "Alcor", 67301: "Alkaid", 68702: "Hadar", 68756: "Thuban", 68933: "Menkent",
    69673: "Arcturus", 71683: "Rigil Kentaurus", 72105: "Izar", 72607: "Kochab", 72622: "Zubenelgenubi", 76267:
    "Alphecca", 77070: "Unukalhai", 80763: "Antares", 82273: "Atria", 84012: "Sabik", 84345: "Rasalgethi", 85927:
    "Shaula", 86032: "Rasalhague", 86742: "Cebalrai", 87833: "Eltanin", 90185: "Kaus Australis", 91262: "Vega",
    92420: "Sheliak", 92855: "Nunki", 93194: "Sulafat", 95241: "Arkab Prior", 95294: "Arkab Posterior", 95347:
    "Rukbat", 95947: "Albireo", 97278: "Tarazed", 97649: "Altair", 98036: "Alshain", 100453: "Sadr", 100751:
    "Peacock", 102098: "Deneb", 105199: "Alderamin", 106032: "Alfirk", 107315: "Enif", 109074: "Sadalmelik", 109268:
    "Alnair", 113368: "Fomalhaut", 113881: "Scheat", 113963: "Markab",
}
"""Names of the working group on star names of the IAU, of the stars that ephem lists, matched within 40 arcseconds."""
# fmt: on


def title_of(body: str) -> str:
    """Return what a person calls a body: Sirius, HIP 12345, Venus."""
    if not body.startswith(STAR):
        return body.capitalize()
    number = int(body.removeprefix(STAR))
    return _NAMES.get(number, f"HIP {number}")
