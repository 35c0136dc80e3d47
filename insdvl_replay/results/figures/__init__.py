"""The figures of a dive's page, one question each: what filters believe, how wrong they are, what they had to go on."""
