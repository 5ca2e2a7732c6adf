"""Makes tea as the recipe says."""

from household import kitchen, perform

RECIPE = {"tea": ["cup", "milk"], "soup": ["pot", "bowl"]}
ARMS = {"cup": "left", "pot": "right", "bowl": "left"}

world = kitchen(cup=[1.35, 0.9, 0.9], milk=[1.35, 0.6, 0.95])
for ingredient in RECIPE["tea"]:
    arm = ARMS[ingredient]  # @cause
    perform(type="pick-up", object=world.get_object(ingredient), arm=arm)
    perform(type="move-arm-joints", **{f"{arm}_arm": "park"})
world.exit()
