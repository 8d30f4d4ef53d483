"""Evidence at rest: visits, each hypothesis fitted in full and weighed by its marginal likelihood."""
