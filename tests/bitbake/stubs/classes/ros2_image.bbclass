# stands for openembedded-core's or meta-ros'
